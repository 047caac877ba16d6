"""The sections of the report."""

from __future__ import annotations

import numpy as np

from app.kinematics.machine import LinearAxis, Machine
from app.kinematics.symbols import error_motions as symbols_of
from app.kinematics.symbols import meaning
from app.reporting.error_tables import MICRO, MILLI, ErrorTable
from app.reporting.figures import SIGN, axis_figure, residual_figure, volume_figure
from app.reporting.findings import Findings
from app.reporting.html_parts import (
    callout,
    drawing,
    escape,
    expanded,
    facts,
    figure_text,
    plain,
    section,
    table,
)
from app.reporting.volumetric_error import Spread

_K = 2.0
GOOD_FIT = 1.15  # residual over noise up to which the model explains the measurement


def fit_ratio(found: Findings) -> float:
    """Return the residual over what the noise alone would leave."""
    residuals = found.estimate.residuals
    return residuals.rms_mm / max(residuals.floor_mm, 1e-12)


def machine_and_measurement(number: int, found: Findings) -> str:
    """Say what was measured, and with what."""
    machine, estimate = found.estimate.model.machine, found.estimate
    run = found.provenance.run
    used = 100.0 * estimate.used_samples / max(estimate.offered_samples, 1)
    things = "lines" if run.mode == "otf" else "points"
    pairs = [
        ("Machine", escape(machine.name)),
        ("Kinematic chain", f"<code>{escape(machine.chain)}</code>"),
        ("Travel", ", ".join(_travel(axis) for axis in machine.linear_axes)),
        ("Target offset", _targets(machine)),
        ("Mode", _mode(found)),
        ("Commanded", f"{run.lines} {things}, {estimate.lines} of them recognised"),
        ("Measuring time", f"{run.measured_s / 60.0:.1f} min"),
        (
            "Samples",
            f"{estimate.offered_samples:,} recorded, {used:.0f} % used, reduced to "
            f"{estimate.cells:,} cells",
        ),
        ("Tracker", _tracker(found)),
    ]
    if run.temperature_degc:
        pairs.append(("Temperature", _temperature(run.temperature_degc)))
    return section(number, "Machine and measurement", facts(pairs))


def error_motions(number: int, found: Findings) -> str:
    """Show each error motion over its axis."""
    gauge = (
        "Positioning and angular errors are 0 at the axis zero, else at the lowest "
        "position. Straightness has its end-point line removed; the slopes are in the "
        "squareness. A rigid motion of the whole volume is no machine error."
    )
    parts = [f"<p class=note>{gauge} {_validity(found)}</p>", _overview(found)]
    for axis in found.estimate.model.machine.linear_axes:
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
        f"{axis.name} {plain(position, 0)}"
        for axis, position in zip(
            found.estimate.model.machine.linear_axes,
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
        f"{place} mm: ({vector}) µm in x, y, z.</p>",
        drawing(volume_figure(found), caption),
    )


def residuals_and_noise(number: int, found: Findings) -> str:
    """Show what the model leaves, and the noise that was found."""
    noise, ratio = found.noise, fit_ratio(found)
    residuals = found.estimate.residuals
    rms, floor = (plain(MILLI * v, 2) for v in (residuals.rms_mm, residuals.floor_mm))
    verdict = f"Residual of the cells {rms} µm, noise alone {floor} µm: " + (
        "the model explains the measurement to its noise."
        if ratio <= GOOD_FIT
        else f"{ratio:.1f} times the noise. The model lacks something that the "
        "machine does (backlash, thermal growth, a drifting set-up); discovery "
        "names candidates, and the stated uncertainties do not cover it."
    )
    head = ("Standard deviation, µm", "along the beam", "across the beam")
    rows = [
        (name, *(plain(v, 2) for v in values))
        for name, values in (
            ("One sample, as the tracker states", noise.stated_um),
            ("One sample, white part found", noise.white_um),
            ("Correlated part found", noise.slow_um),
        )
    ]
    return section(
        number,
        "Residuals and noise",
        callout(verdict, warn=ratio > GOOD_FIT),
        drawing(
            residual_figure(found),
            "Root mean square of one residual component on each row, and the "
            "distribution over all cells in the frame of the beam.",
        ),
        table(head, rows, numbers=1),
        f"<p class=note>At the mean distance of {noise.distance_mm / 1000.0:.2f} m. "
        f"The correlated part fades with {noise.slow_time_s:.2g} s; samples are never "
        f"counted as independent within it. {_along(found)}</p>",
    )


def unobservable(number: int, found: Findings) -> str:
    """Say in words what this measurement cannot tell."""
    seen = found.estimate.observability
    if not seen.unobservable:
        text = "<p>Nothing of the model: all error motions were told apart.</p>"
    else:
        items = "".join(f"<li>{escape(s)}</li>" for s in seen.unobservable)
        text = (
            "<p>Motions that merge with others were left out of the solve rather than "
            "set to zero; the tables of the others hold for the measured target only."
            f"</p><ul>{items}</ul>"
        )
    note = (
        f"<p class=note>The measurement determines {seen.rank} of {seen.parameters} "
        "shapes of error motions and squarenesses.</p>"
    )
    return section(number, "What this measurement cannot tell", text, note)


def validation(number: int, found: Findings) -> str:
    """Say what has been shown and what has not."""
    ratio = found.volumetric.after.mean.value_um / max(
        found.volumetric.before.mean.value_um, 1e-12
    )
    return section(
        number,
        "Validation",
        f"<p>The error expected after compensation ({100.0 * ratio:.1f} % of the mean "
        "before) follows from the uncertainty of this estimate. It has not been "
        "measured: that the controller applies the tables with the right sign, and "
        "that the machine repeats, is for a run of its own to show.</p>"
        "<p>ISO/TR 16907 asks for that in clause 11: with compensation on, measure "
        "lines that this run did not use (face and space diagonals by ISO 230-6, "
        "positioning by ISO 230-2, circles by ISO 230-4) and compare with this "
        "report.</p>",
    )


def documentation(number: int, found: Findings) -> str:
    """State where the numbers come from."""
    provenance, run = found.provenance, found.provenance.run
    along = (
        "across the travel only"
        if found.estimate.perpendicular_only
        else ("across the travel, and along it with phase and speed of each line free")
    )
    pairs = [
        ("Software", f"truepath {escape(provenance.software_version)}"),
        ("Analysed", f"{provenance.created.isoformat(timespec='seconds')}"),
        ("Run", escape(run.name)),
        ("Input, SHA-256", f"<code>{run.digest}</code>"),
        *((escape(k), f"<code>{escape(v)}</code>") for k, v in run.source.items()),
        ("Deviations used", along if run.mode == "otf" else "all directions"),
        ("Tracker pose", _pose(found)),
        (
            "Model",
            f"{found.estimate.model.size} parameters: natural cubic splines with the "
            "bending energy as prior, its strength found from the data; tracker pose "
            "and timing solved jointly",
        ),
        ("Uncertainty", "GUM propagation of the full covariance, correlated noise"),
    ]
    return section(number, "Documentation", facts(pairs))


def _travel(axis: LinearAxis) -> str:
    return f"{axis.name} {plain(axis.min_mm, 0)} to {plain(axis.max_mm, 0)} mm"


def _targets(machine: Machine) -> str:
    return "; ".join(
        (f"{escape(t.name)} " if t.name else "")
        + f"({', '.join(plain(v) for v in t.offset_mm)}) mm on the {t.on}"
        for t in machine.targets
    )


def _mode(found: Findings) -> str:
    feed = found.provenance.run.feed_mm_min
    if feed is None:
        return "standstill points"
    low, high = feed
    speed = f"{low:,.0f}" if low == high else f"{low:,.0f} to {high:,.0f}"
    return f"on the fly at {speed} mm/min"


def _tracker(found: Findings) -> str:
    tracker = found.estimate.model.machine.tracker
    distance = found.noise.distance_mm / 1000.0
    return (
        f"{distance:.2f} m from the tool on average, {tracker.rate_hz:g} samples a "
        f"second, standing on the {tracker.stands_on}"
    )


def _temperature(seen: dict[str, tuple[float, float]]) -> str:
    return ", ".join(
        f"{escape(name)} {low:.2f} to {high:.2f} °C"
        for name, (low, high) in seen.items()
    )


def _validity(found: Findings) -> str:
    if found.tables.any_tool:
        return "All motions are told apart: the tables hold for any tool."
    return "The tables hold for the measured target offset only (section 6)."


def _overview(found: Findings) -> str:
    rows = [
        (f"<code>{symbol}</code>", meaning(symbol), *_sizes(found.tables.table(symbol)))
        for axis in found.estimate.model.machine.linear_axes
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


def _values(found: Findings, axis: LinearAxis) -> str:
    known = [found.tables.table(symbol) for symbol in symbols_of(axis.name)]
    tables = [t for t in known if t is not None]
    if not tables:
        return ""
    head = [f"{axis.name}, mm", *(f"{t.symbol}, {SIGN[t.unit]}" for t in tables)]
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


def _along(found: Findings) -> str:
    jitter = found.noise.along_travel_um
    if jitter is None:
        return "What lies along the travel was not used."
    return f"Along the travel the feed scatters by {jitter:.2g} µm a cell."


def _pose(found: Findings) -> str:
    sigma = _K * np.sqrt(np.maximum(np.diag(found.estimate.pose_covariance), 0.0))
    shift = ", ".join(f"{v:.2g}" for v in MILLI * sigma[:3])
    turn = ", ".join(f"{v:.2g}" for v in MICRO * sigma[3:])
    place = ", ".join(plain(v) for v in _stand_mm(found))
    return (
        f"tracker at ({place}) mm in the workpiece frame; U (k = 2) of the pose "
        f"({shift}) µm and ({turn}) µrad"
    )


def _stand_mm(found: Findings) -> list[float]:
    return found.estimate.pose.inverse().shift_mm.tolist()
