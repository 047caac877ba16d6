"""What trials say of the stated uncertainties, as a part of the report."""

from __future__ import annotations

import numpy as np

from app.kinematics.symbols import meaning
from app.numerics.adaptive_trials import NORMAL_FACTOR
from app.reporting.axis_panels import SIGN
from app.reporting.html_parts import callout, table
from app.results.held_trials import MAP, HeldQuantity, HeldTrials
from app.results.numbers_as_text import plain


def trials(held: HeldTrials) -> str:
    """Show how the linear law stands against the trials, quantity by quantity."""
    head = (
        "Symbol",
        "Quantity",
        "u, linear",
        "u, trials",
        "95 % half width, linear",
        "95 % half width, trials",
        "agrees",
    )
    rows = [_row(q) for q in held.quantities]
    return (
        "<h3>Uncertainty held against trials</h3>"
        f"{callout(_verdict(held), warn=not held.agrees)}"
        f"{table(head, rows, numbers=2)}<p class=note>{_how(held)}</p>"
    )


def _verdict(held: HeldTrials) -> str:
    if not held.settled:
        return (
            f"{held.trials:,} trials did not settle to the digits asked for: the "
            "comparison is not decided."
        )
    if held.agrees:
        return (
            f"{held.trials:,} trials validate the linear uncertainty of every table "
            "and of the volumetric error (JCGM 101, clause 8)."
        )
    failed = [q.name for q in held.quantities if not q.agrees.all()]
    return (
        f"{held.trials:,} trials validate the linear uncertainty of {held.agreeing} of "
        f"{held.numbers} numbers (JCGM 101, clause 8), not all of "
        f"{', '.join(failed)}: use the intervals of the trials there."
    )


def _row(q: HeldQuantity) -> tuple[str, ...]:
    """Show a quantity where its linear uncertainty is largest."""
    i = int(np.argmax(q.linear))
    sign = SIGN[q.unit]
    half = (q.high[i] - q.low[i]) / 2.0
    symbol = "" if q.name == MAP else f"<code>{q.name}</code>"
    share = int(q.agrees.sum())
    return (
        symbol,
        "volumetric error" if q.name == MAP else meaning(q.name),
        f"{plain(q.linear[i], 3)} {sign}",
        f"{plain(q.sigma[i], 3)} {sign}",
        f"{plain(NORMAL_FACTOR * q.linear[i], 3)} {sign}",
        f"{plain(half, 3)} {sign}",
        f"{share} of {len(q.agrees)}",
    )


def _how(held: HeldTrials) -> str:
    plan = held.plan
    digits = "1 digit" if plan.digits == 1 else f"{plan.digits} digits"
    form = "probabilistically symmetric" if plan.interval == "symmetric" else "shortest"
    return (
        "Each row where its uncertainty is largest. Every trial draws noise, jitter "
        "and prior anew from their description and solves again; blocks of 10,000 were "
        "added until twice the standard deviation of each result was within a fifth of "
        f"half a unit of {digits} of its uncertainty. Intervals are the {form} ones; "
        f"seed {plan.seed}."
    )
