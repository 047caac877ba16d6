"""The report's sections about the errors: motions, squareness, volumetric error."""

from __future__ import annotations

import numpy as np

from app.kinematics.machine import Axis, position_unit
from app.kinematics.symbols import error_motions as symbols_of
from app.kinematics.symbols import meaning
from app.reporting.axis_panels import SIGN
from app.reporting.figures import axis_figure
from app.reporting.html_parts import drawing, figure_text, section, table
from app.reporting.volume_figure import volume_figure
from app.results.error_tables import ErrorTable
from app.results.findings import Findings
from app.results.numbers_as_text import expanded, plain
from app.results.volumetric_error import Spread

_K = 2.0


def error_motions(number: int, found: Findings) -> str:
    """Show each error motion over its axis."""
    gauge = (
        "Positioning and angular errors are 0 at the axis zero, else at the lowest "
        "position. Straightness has its end-point line removed; the slopes are in the "
        "squareness. A rigid motion of the whole volume is no machine error."
    )
    parts = [f"<p class=note>{gauge} {_validity(found)}</p>", _overview(found)]
    for axis in found.estimate.model.machine.axes:
        parts.append(f"<h3>Axis {axis.name}</h3>")
        parts.append(
            drawing(axis_figure(found, axis), "Estimate with its band of ±U (k = 2).")
        )
        parts.append(_values(found, axis))
    return section(number, "Error motions", *parts)


def squareness(number: int, found: Findings) -> str:
    """List the squarenesses."""
    rows = [
        (
            f"<code>{s.symbol}</code>",
            meaning(s.symbol),
            f"{expanded(s.value_urad, s.uncertainty_urad)} µrad",
        )
        for s in found.tables.squareness
    ]
    rows += [
        (
            f"<code>{s.symbol}</code>",
            meaning(s.symbol),
            f"{expanded(s.value, s.uncertainty)} {SIGN[s.unit]}",
        )
        for s in found.tables.locations
    ]
    text = (
        "Between the end-point lines of the axes, as right-handed turns about the axis "
        "in the symbol; the uncertainty is expanded (k = 2)."
    )
    head = ("Symbol", "Error", "Value ± U")
    return section(
        number, "Squareness", table(head, rows, numbers=2), f"<p class=note>{text}</p>"
    )


def volumetric(number: int, found: Findings) -> str:
    """State what the errors do at the tool point, before and after compensation."""
    seen = found.volumetric
    rows = [
        ("Before compensation", *_figures(seen.before)),
        ("After, expected", *_figures(seen.after)),
    ]
    worst = int(np.argmax(np.linalg.norm(seen.error_um, axis=1)))
    place = ", ".join(
        f"{axis.name} {plain(position, 0)} {position_unit(axis)}"
        for axis, position in zip(
            found.estimate.model.machine.axes,
            seen.position_mm[worst],
            strict=True,
        )
    )
    vector = ", ".join(
        expanded(value, sigma)
        for value, sigma in zip(
            seen.error_um[worst], seen.uncertainty_um[worst], strict=True
        )
    )
    head = ("Length of the volumetric error, µm", "mean", "95 % of points", "largest")
    caption = (
        "Left: the volume as its errors deform it, seen from the front, right and "
        "above. Right: how much of the volume lies within a given error; the expected "
        "rest is what the stated uncertainty leaves where the full correction is "
        "applied."
    )
    return section(
        number,
        "Volumetric error",
        table(head, rows, numbers=1),
        f"<p class=note>On a grid of {len(seen.position_mm)} points over the travel, "
        "without the rigid motion of the whole volume. The largest error stands at "
        f"{place}: ({vector}) µm in x, y, z.</p>",
        drawing(volume_figure(found), caption),
    )


def _validity(found: Findings) -> str:
    if found.tables.any_tool:
        return "All motions are told apart: the tables hold for any tool."
    return "The tables hold for the measured target offset only (section 7)."


def _overview(found: Findings) -> str:
    rows = [
        (f"<code>{symbol}</code>", meaning(symbol), *_sizes(found.tables.table(symbol)))
        for axis in found.estimate.model.machine.axes
        for symbol in symbols_of(axis.name)
    ]
    head = ("Symbol", "Error motion", "range", "largest", "largest U (k = 2)")
    return table(head, rows, numbers=2)


def _sizes(known: ErrorTable | None) -> tuple[str, str, str]:
    if known is None:
        return "", "", "<span class=note>not observable</span>"
    unit = SIGN[known.unit]
    return (
        f"{plain(float(np.ptp(known.value)))} {unit}",
        f"{plain(float(np.abs(known.value).max()))} {unit}",
        f"{plain(_K * float(known.uncertainty.max()), 2)} {unit}",
    )


def _values(found: Findings, axis: Axis) -> str:
    known = [found.tables.table(symbol) for symbol in symbols_of(axis.name)]
    tables = [t for t in known if t is not None]
    if not tables:
        return ""
    head = [
        f"{axis.name}, {position_unit(axis)}",
        *(f"{t.symbol}, {SIGN[t.unit]}" for t in tables),
    ]
    rows = [
        (plain(position, 2), *(_value(t, i) for t in tables))
        for i, position in enumerate(tables[0].position_mm)
    ]
    return (
        f"<details><summary>Values of axis {axis.name} with U (k = 2)</summary>"
        f"{table(head, rows)}</details>"
    )


def _value(known: ErrorTable, index: int) -> str:
    return expanded(float(known.value[index]), float(known.uncertainty[index]))


def _figures(spread: Spread) -> tuple[str, str, str]:
    return (
        figure_text(spread.mean),
        figure_text(spread.p95),
        figure_text(spread.largest),
    )
