"""What the report says of the set-up: its grade, weak shapes, extrapolated ends."""

from __future__ import annotations

from collections.abc import Sequence

from app.kinematics.machine import position_unit
from app.reporting.html_parts import escape
from app.results.error_tables import MILLI
from app.results.findings import Findings
from app.results.grade_json import in_words
from app.results.numbers_as_text import plain


def grade_of_set_up(found: Findings) -> tuple[tuple[str, str], ...]:
    """Return the grade as a fact, if there is one."""
    if found.grade is None:
        return ()
    number = f"<strong>{found.grade.number:.2f}</strong>"
    text = (
        f"{escape(in_words(found.grade))} The number is the expected standard "
        "uncertainty of the volumetric error over the "
        f"{plain(MILLI * found.grade.sample_sigma_mm, 1)} µm "
        "that one tracker sample scatters, from geometry alone: up to 0.25 good, up to "
        "1 usable."
    )
    return ((f"Grade of the set-up: {number}", text),)


def weakly_told(found: Findings) -> str:
    """List the shapes that the data determine only weakly."""
    weak = found.estimate.observability.weak
    if not weak:
        return (
            "<p>No shape that matters was told only weakly: what the tables say comes "
            "from the measurement.</p>"
        )
    return (
        "<p>These shapes were told, but only weakly: the tables state them with an "
        f"uncertainty that owes more to what is usual of machines.</p>{_listed(weak)}"
    )


def extrapolated_ends(found: Findings) -> str:
    """Say where the tables go beyond what was measured."""
    ends: list[str] = []
    for axis in found.estimate.model.machine.axes:
        low, high = found.estimate.measured.get(axis.name, (axis.low, axis.high))
        unit = position_unit(axis)
        if low > axis.low:
            ends.append(f"{axis.name} {plain(axis.low, 0)} to {plain(low, 0)} {unit}")
        if high < axis.high:
            ends.append(f"{axis.name} {plain(high, 0)} to {plain(axis.high, 0)} {unit}")
    if not ends:
        return ""
    return (
        "<p class=note>Extrapolated, with a bounded slope and a growing uncertainty: "
        f"{', '.join(ends)}. The files mark these positions.</p>"
    )


def _listed(statements: Sequence[str]) -> str:
    return f"<ul>{''.join(f'<li>{escape(s)}</li>' for s in statements)}</ul>"
