"""The report's section on the effects that a model has brought."""

from __future__ import annotations

from app.kinematics.effects.catalogue import Measured
from app.reporting.html_parts import callout, escape, section, table
from app.results.effects_beside import (
    EffectBeside,
    ModelAccount,
    effects_beside,
    taken,
)
from app.results.findings import Findings
from app.results.model_difference import in_words


def effects(number: int, found: Findings) -> str:
    """State the effects beside the error motions, before and with this measurement."""
    account = found.provenance.model
    if account is None:
        return ""
    title = "Effects of the machine beside its error motions"
    text = (
        f"<p>From version {account.version} of the model "
        f"({escape(account.source)}): {escape(taken(account))}.</p>"
    )
    beside = effects_beside(found.estimate)
    if not beside:
        return section(number, title, text, "<p>The model has none.</p>")
    head = ("Effect", "Known before", "With this measurement")
    rows = [_row(one, account) for one in beside]
    return section(number, title, text, table(head, rows, numbers=3), _verdict(beside))


def _row(one: EffectBeside, account: ModelAccount) -> tuple[str, str, str]:
    before = "not used" if account.of_these_runs else _numbers(one.before)
    return escape(one.title), before, _numbers(one.after)


def _numbers(found: dict[str, Measured]) -> str:
    said = [in_words(name, m.value, m.uncertainty) for name, m in found.items()]
    return escape("; ".join(said))


def _verdict(beside: tuple[EffectBeside, ...]) -> str:
    """Say so where the measurement contradicts the model."""
    against = [one.title for one in beside if one.agrees is False]
    if not against:
        return (
            "<p class=note>Tables and map are those of the machine with these effects; "
            "their uncertainty is in that of the tables.</p>"
        )
    return callout(
        f"This measurement contradicts the model: {escape('; '.join(against))}. The "
        "machine has changed since; let discovery find what it lacks now.",
        warn=True,
    )
