"""The report's sections about the measurement: how, how well, what it cannot tell."""

from __future__ import annotations

import numpy as np

from app.kinematics.machine import Axis, Machine, position_unit
from app.reporting.error_tables import MICRO, MILLI
from app.reporting.figures import residual_figure
from app.reporting.findings import Findings
from app.reporting.html_parts import (
    callout,
    drawing,
    escape,
    facts,
    plain,
    section,
    table,
)
from app.reporting.report_grade import (
    extrapolated_ends,
    grade_of_set_up,
    weakly_told,
)
from app.reporting.report_trials import trials

GOOD_FIT = 1.15  # residual over noise up to which the model explains the measurement
_K = 2.0


def machine_and_measurement(number: int, found: Findings) -> str:
    """Say what was measured, and with what."""
    machine, estimate = found.estimate.model.machine, found.estimate
    run = found.provenance.run
    used = 100.0 * estimate.used_samples / max(estimate.offered_samples, 1)
    things = "lines" if run.mode == "otf" else "points"
    pairs = [
        ("Machine", escape(machine.name)),
        ("Kinematic chain", f"<code>{escape(machine.chain)}</code>"),
        ("Travel", ", ".join(_travel(axis) for axis in machine.axes)),
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
        *grade_of_set_up(found),
    ]
    if run.temperature_degc:
        pairs.append(("Temperature", _temperature(run.temperature_degc)))
    return section(number, "Machine and measurement", facts(pairs))


def residuals_and_noise(number: int, found: Findings) -> str:
    """Show what the model leaves, and the noise that was found."""
    noise, ratio = found.noise, fit_ratio(found)
    residuals = found.estimate.residuals
    rms, floor = (plain(MILLI * v, 2) for v in (residuals.rms_mm, residuals.floor_mm))
    verdict = f"Residual of the cells {rms} µm, noise alone {floor} µm: " + (
        "the model explains the measurement to its noise."
        if ratio <= GOOD_FIT
        else f"{ratio:.1f} times the noise. The model lacks something that the "
        "machine does: look for backlash, thermal growth or a set-up that drifted. "
        "The stated uncertainties do not cover it."
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
            "<p>These stay open. Motions that merge with others were left out of the "
            "solve rather than set to zero; the tables of the others hold for "
            f"the measured target only.</p><ul>{items}</ul>"
        )
    note = (
        f"<p class=note>The measurement determines {seen.rank} of {seen.parameters} "
        "shapes of error motions and squarenesses.</p>"
    )
    return section(
        number,
        "What this measurement cannot tell",
        text,
        weakly_told(found),
        note,
        extrapolated_ends(found),
    )


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
        "" if found.trials is None else trials(found.trials),
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
            f"{'and timing of each line ' if run.mode == 'otf' else ''}solved jointly",
        ),
        ("Uncertainty", "GUM propagation of the full covariance, correlated noise"),
    ]
    return section(number, "Documentation", facts(pairs))


def fit_ratio(found: Findings) -> float:
    """Return the residual over what the noise alone would leave."""
    residuals = found.estimate.residuals
    return residuals.rms_mm / max(residuals.floor_mm, 1e-12)


def _travel(axis: Axis) -> str:
    low, high, unit = plain(axis.low, 0), plain(axis.high, 0), position_unit(axis)
    return f"{axis.name} {low} to {high} {unit}"


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


def _along(found: Findings) -> str:
    jitter = found.noise.along_travel_um
    if found.provenance.run.mode != "otf":
        return ""
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
