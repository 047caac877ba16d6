"""What the report states of the measurement: how, how well, its limits, its origin."""

from __future__ import annotations

import numpy as np

from app.files.units import UM_PER_MM
from app.kinematics.machine import Axis, Machine, position_unit
from app.kinematics.symbols import describe_symbol
from app.numerics.adaptive_trials import NORMAL_FACTOR
from app.reporting.axis_panels import SIGN
from app.reporting.run_views import (
    describe_measurement,
    describe_origin,
    describe_run_residuals,
)
from app.reporting.templating import View
from app.results.findings import Findings
from app.results.grade_json import in_words
from app.results.number_format import format_number
from app.results.trial_results import MAP, TrialQuantity, TrialResults

GOOD_FIT = 1.15  # residual over noise up to which the model explains the measurement


def residual_over_noise(findings: Findings) -> float:
    """Return the residual over that of noise alone."""
    return findings.estimate.rms_mm / max(findings.estimate.floor_mm, 1e-12)


def describe_machine(findings: Findings) -> View:
    """Return machine, grade of the set-up, and how each Run was measured."""
    machine, grade = findings.estimate.model.machine, findings.grade
    return {
        "machine": machine.name,
        "chain": machine.chain,
        "travel": ", ".join(_state_travel(axis) for axis in machine.axes),
        "targets": _state_targets(machine),
        "grade": None
        if grade is None
        else {
            "number": f"{grade.number:.2f}",
            "text": in_words(grade),
            "sample_sigma_um": format_number(UM_PER_MM * grade.sample_sigma_mm, 1),
        },
        "runs": [describe_measurement(run) for run in findings.runs],
    }


def describe_residuals(findings: Findings) -> View:
    """Return the residual of the model, and the noise of each Run."""
    return {
        "rms_um": UM_PER_MM * findings.estimate.rms_mm,
        "floor_um": UM_PER_MM * findings.estimate.floor_mm,
        "ratio": residual_over_noise(findings),
        "good_fit": GOOD_FIT,
        "runs": [describe_run_residuals(run) for run in findings.runs],
    }


def describe_limits(findings: Findings) -> View:
    """Return what this measurement does not observe, or observes poorly."""
    observability = findings.estimate.observability
    return {
        "unobservable": observability.unobservable,
        "poorly_observable": observability.poorly_observable,
        "rank": observability.rank,
        "parameters": observability.parameters,
        "extrapolated": _list_extrapolated(findings),
    }


def describe_validation(findings: Findings) -> View:
    """Return what has been shown, and what has not."""
    before, after = findings.volumetric.before.mean, findings.volumetric.after.mean
    trials = findings.trials
    return {
        "share": after.value_um / max(before.value_um, 1e-12),
        "trials": None if trials is None else describe_trials(trials),
    }


def describe_trials(trials: TrialResults) -> View:
    """Return the linear uncertainty against the trials, quantity by quantity."""
    return {
        "settled": trials.settled,
        "agree": trials.agrees,
        "trials": f"{trials.trials:,}",
        "agreeing": trials.agreeing,
        "numbers": trials.numbers,
        "failed": [q.name for q in trials.quantities if not q.agrees.all()],
        "rows": [_state_quantity(q) for q in trials.quantities],
        "digits": trials.plan.digits,
        "symmetric": trials.plan.interval == "symmetric",
        "seed": trials.plan.seed,
    }


def describe_documentation(findings: Findings) -> View:
    """Return the origin of the numbers."""
    provenance, across_only = findings.provenance, findings.estimate.perpendicular_only
    return {
        "software": provenance.software_version,
        "analysed": provenance.created.isoformat(timespec="seconds"),
        "parameters": findings.estimate.model.size,
        "timing": any(run.mode == "otf" for run in provenance.runs),
        "runs": [
            describe_origin(run, across_only=across_only) for run in findings.runs
        ],
    }


def _state_travel(axis: Axis) -> str:
    low, high, unit = (
        format_number(axis.low, 0),
        format_number(axis.high, 0),
        position_unit(axis),
    )
    return f"{axis.name} {low} to {high} {unit}"


def _state_targets(machine: Machine) -> str:
    return "; ".join(
        f"{t.name} ({offset}) mm on the {t.on}".strip()
        for t in machine.targets
        for offset in [", ".join(format_number(value) for value in t.offset_mm)]
    )


def _list_extrapolated(findings: Findings) -> list[str]:
    """Return the ends of the travel that were not measured."""
    ends: list[str] = []
    for axis in findings.estimate.model.machine.axes:
        low, high = findings.estimate.measured.get(axis.name, (axis.low, axis.high))
        for begin, end in ((axis.low, low), (high, axis.high)):
            if begin < end:
                span = f"{format_number(begin, 0)} to {format_number(end, 0)}"
                ends.append(f"{axis.name} {span} {position_unit(axis)}")
    return ends


def _state_quantity(q: TrialQuantity) -> tuple[str, ...]:
    """Return a quantity at the position of its largest linear uncertainty."""
    i = int(np.argmax(q.linear))
    is_map = q.name == MAP
    half = (q.high[i] - q.low[i]) / 2.0
    sizes = q.linear[i], q.sigma[i], NORMAL_FACTOR * q.linear[i], half
    return (
        "" if is_map else q.name,
        "volumetric error" if is_map else describe_symbol(q.name),
        *(f"{format_number(size, 3)} {SIGN[q.unit]}" for size in sizes),
        f"{int(q.agrees.sum())} of {len(q.agrees)}",
    )
