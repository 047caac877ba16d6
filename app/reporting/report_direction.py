"""The report's section on the direction of approach."""

from __future__ import annotations

import numpy as np

from app.kinematics.symbols import meaning
from app.reporting.html_parts import section, table
from app.results.direction_tables import HalfDifference, half_differences
from app.results.findings import Findings
from app.results.numbers_as_text import expanded

_SAID = {
    "none": "The data give no sign that the direction of approach matters: tables that "
    "tell both directions apart explain them no better.",
    "constant": "Errors differ with the direction of approach by the same amount "
    "everywhere on an axis.",
    "tables": "Errors differ with the direction of approach by an amount that changes "
    "along the axis.",
}


_KNOWN = (
    "The lost motion that the model knows, and no sign in the data that the direction "
    "of approach matters beyond it."
)


def direction(number: int, found: Findings) -> str:
    """Say whether lost motion was found, and how much."""
    estimate = found.estimate
    halves = half_differences(estimate.model, estimate.theta, estimate.covariance)
    is_known = estimate.direction == "none" and halves
    text = f"<p>{_KNOWN if is_known else _SAID[estimate.direction]}</p>"
    shown = [half for half in halves if half.shows]
    if not halves:
        return section(number, "Direction of approach", text)
    rows = [_row(half) for half in shown]
    head = ("Symbol", "Error", "Half difference ± U")
    note = (
        "Going up, an axis errs by its table plus the half difference, coming down by "
        f"the table less it. {len(halves) - len(shown)} error motions show none beyond "
        "their expanded uncertainty (k = 2)."
    )
    body = table(head, rows, numbers=2) if rows else ""
    return section(
        number, "Direction of approach", text, body, f"<p class=note>{note}</p>"
    )


def _row(half: HalfDifference) -> tuple[str, str, str]:
    worst = int(np.argmax(np.abs(half.value)))
    value = expanded(float(half.value[worst]), float(half.uncertainty[worst]))
    unit = "µrad" if half.unit == "urad" else "µm"
    return f"<code>{half.symbol}</code>", meaning(half.symbol), f"{value} {unit}"
