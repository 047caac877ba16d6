"""The report's sections about the measurement: how, how well, what it cannot tell."""

from __future__ import annotations

from functools import partial

from app.kinematics.machine import Axis, Machine, position_unit
from app.reporting.html_parts import callout, escape, facts, section
from app.reporting.report_grade import (
    extrapolated_ends,
    grade_of_set_up,
    weakly_told,
)
from app.reporting.report_runs import each_run, measurement, origin, residuals
from app.reporting.report_trials import trials
from app.results.error_tables import MILLI
from app.results.findings import Findings
from app.results.numbers_as_text import plain

GOOD_FIT = 1.15  # residual over noise up to which the model explains the measurement


def machine_and_measurement(number: int, found: Findings) -> str:
    """Say what was measured, and with what."""
    machine = found.estimate.model.machine
    pairs = [
        ("Machine", escape(machine.name)),
        ("Kinematic chain", f"<code>{escape(machine.chain)}</code>"),
        ("Travel", ", ".join(_travel(axis) for axis in machine.axes)),
        ("Target offset", _targets(machine)),
        *grade_of_set_up(found),
    ]
    return section(
        number,
        "Machine and measurement",
        facts(pairs),
        each_run(found, measurement),
    )


def residuals_and_noise(number: int, found: Findings) -> str:
    """Show what the model leaves, and the noise that was found."""
    ratio = fit_ratio(found)
    both = (found.estimate.rms_mm, found.estimate.floor_mm)
    rms, floor = (plain(MILLI * v, 2) for v in both)
    verdict = f"Residual of the cells {rms} µm, noise alone {floor} µm: " + (
        "the model explains the measurement to its noise."
        if ratio <= GOOD_FIT
        else f"{ratio:.1f} times the noise. The model lacks something that the "
        "machine does: look for backlash, thermal growth or a set-up that drifted. "
        "The stated uncertainties do not cover it."
    )
    return section(
        number,
        "Residuals and noise",
        callout(verdict, warn=ratio > GOOD_FIT),
        each_run(found, residuals),
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
    provenance, across_only = found.provenance, found.estimate.perpendicular_only
    timing = any(run.mode == "otf" for run in provenance.runs)
    pairs = [
        ("Software", f"truepath {escape(provenance.software_version)}"),
        ("Analysed", f"{provenance.created.isoformat(timespec='seconds')}"),
        (
            "Model",
            f"{found.estimate.model.size} parameters: natural cubic splines with the "
            "bending energy as prior, its precision found from the data; tracker pose "
            f"{'and timing of each line ' if timing else ''}solved jointly",
        ),
        ("Uncertainty", "GUM propagation of the full covariance, correlated noise"),
    ]
    runs = each_run(found, partial(origin, across_only=across_only))
    return section(number, "Documentation", facts(pairs), runs)


def fit_ratio(found: Findings) -> float:
    """Return the residual over what the noise alone would leave."""
    return found.estimate.rms_mm / max(found.estimate.floor_mm, 1e-12)


def _travel(axis: Axis) -> str:
    low, high, unit = plain(axis.low, 0), plain(axis.high, 0), position_unit(axis)
    return f"{axis.name} {low} to {high} {unit}"


def _targets(machine: Machine) -> str:
    return "; ".join(
        (f"{escape(t.name)} " if t.name else "")
        + f"({', '.join(plain(v) for v in t.offset_mm)}) mm on the {t.on}"
        for t in machine.targets
    )
