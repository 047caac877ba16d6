"""Sections on the measurement: how, how well, its limits, its origin."""

from __future__ import annotations

import numpy as np

from truepath.answers.shown.error_figures import draw_residuals
from truepath.answers.shown.number_format import SIGN, format_number
from truepath.answers.shown.templating import View
from truepath.estimation.solve.run_estimate import SeatEstimate
from truepath.files.bundle.run import RunSummary, SampleQuality
from truepath.files.environment import ChannelFacts
from truepath.files.units import UM_PER_MM, URAD_PER_RAD
from truepath.kinematics.machine.machine import Axis, Machine, position_unit
from truepath.kinematics.machine.symbols import describe_symbol
from truepath.numerics.adaptive_trials import NORMAL_FACTOR
from truepath.results.grade_json import format_text
from truepath.results.monte_carlo_results import MAP, TrialQuantity, TrialResults
from truepath.results.result_json import (
    describe_refraction,
    describe_scale,
)
from truepath.results.result_summary import Findings, RunFindings

GOOD_FIT = 1.15  # residual over noise up to which the model explains the measurement
_K = 2.0
_UNITS = {"degC": "°C", "hPa": "hPa", "percent": "%"}
_HOW = {"otf": "on the fly", "standstill": "at standstill"}


def name_runs(findings: Findings) -> str:
    """The Runs and their modes in one line; a Run that was split is named once."""
    runs = findings.provenance.runs
    if len(runs) == 1:
        return f"Run {runs[0].name}, measured {_HOW[runs[0].mode]}"
    named = ", ".join(f"{run.name} ({_HOW[run.mode]})" for run in runs)
    return f"Runs {named}, measured"


def residual_over_noise(findings: Findings) -> float:
    """Ratio of the RMS residual to that of noise alone; see `GOOD_FIT`."""
    return findings.estimate.rms_mm / max(findings.estimate.floor_mm, 1e-12)


def describe_machine(findings: Findings) -> View:
    """Machine, grade of the set-up, and how each Run was measured."""
    machine, grade = findings.estimate.model.machine, findings.grade
    return {
        "machine": machine,
        "travel": ", ".join(_state_travel(a, a.low, a.high) for a in machine.axes),
        "targets": _state_targets(machine),
        "grade": None
        if grade is None
        else {
            "number": f"{grade.number:.2f}",
            "text": format_text(grade),
            "sample_sigma_um": format_number(UM_PER_MM * grade.sample_sigma_mm, 1),
        },
        "runs": [_describe_measurement(findings, run) for run in findings.runs],
    }


def describe_residuals(findings: Findings) -> View:
    """RMS of the residual and of noise alone, µm, and the noise of each Run."""
    return {
        "rms_um": UM_PER_MM * findings.estimate.rms_mm,
        "floor_um": UM_PER_MM * findings.estimate.floor_mm,
        "ratio": residual_over_noise(findings),
        "good_fit": GOOD_FIT,
        "runs": [_describe_run_residuals(run) for run in findings.runs],
    }


def describe_limits(findings: Findings) -> View:
    """What this measurement does not observe, or observes poorly."""
    return {
        "found": findings.estimate.observability,
        "extrapolated": _list_extrapolated(findings),
    }


def describe_validation(findings: Findings) -> View:
    """Share of the error that is left after compensation, and the simulated trials."""
    before, after = findings.volumetric.before.mean, findings.volumetric.after.mean
    trials = findings.trials
    return {
        "share": after.value_um / max(before.value_um, 1e-12),
        "trials": None if trials is None else describe_trials(trials),
    }


def describe_trials(trials: TrialResults) -> View:
    """Linear uncertainty compared with the trials, quantity by quantity."""
    return {
        "found": trials,
        "trials": f"{trials.trials:,}",
        "failed": [q.name for q in trials.quantities if not q.agrees.all()],
        "rows": [_state_quantity(q) for q in trials.quantities],
    }


def describe_documentation(findings: Findings) -> View:
    """Poses of the tracker, and where the numbers come from."""
    return {
        "timing": any(run.mode == "otf" for run in findings.provenance.runs),
        "runs": [_describe_pose(run) for run in findings.runs],
    }


def _state_travel(axis: Axis, low: float, high: float) -> str:
    span = f"{format_number(low, 0)} to {format_number(high, 0)}"
    return f"{axis.name} {span} {position_unit(axis)}"


def _state_targets(machine: Machine) -> str:
    return "; ".join(
        f"{t.name} ({offset}) mm on the {t.on}".strip()
        for t in machine.targets
        for offset in [", ".join(format_number(value) for value in t.offset_mm)]
    )


def _list_extrapolated(findings: Findings) -> list[str]:
    ends: list[str] = []
    for axis in findings.estimate.model.machine.axes:
        low, high = findings.estimate.measured.get(axis.name, (axis.low, axis.high))
        for begin, end in ((axis.low, low), (high, axis.high)):
            if begin < end:
                ends.append(_state_travel(axis, begin, end))
    return ends


def _state_quantity(q: TrialQuantity) -> tuple[str, ...]:
    i = int(np.argmax(q.linear))
    is_map = q.name == MAP
    half = (q.high[i] - q.low[i]) / 2.0
    sizes = _K * q.linear[i], _K * q.sigma[i], NORMAL_FACTOR * q.linear[i], half
    return (
        "" if is_map else q.name,
        "volumetric error" if is_map else describe_symbol(q.name),
        *(f"{format_number(size, 3)} {SIGN[q.unit]}" for size in sizes),
        f"{int(q.agrees.sum())} of {len(q.agrees)}",
    )


def _describe_measurement(findings: Findings, run: RunFindings) -> View:
    summary, estimate = run.summary, run.estimate
    brought, without_um = (
        findings.contributions,
        findings.get_uncertainty_without_run_um(run),
    )
    return {
        "summary": summary,
        "estimate": estimate,
        "feed": _state_feed(summary.feed_mm_min),
        "minutes": f"{summary.measured_s / 60.0:.1f}",
        "samples": f"{estimate.offered_samples:,}",
        "used": 100.0 * estimate.used_samples / max(estimate.offered_samples, 1),
        "cells": f"{estimate.cells:,}",
        "distance_m": f"{run.noise.distance_mm / 1000.0:.2f}",
        "rate_hz": f"{estimate.tracker.rate_hz:g}",
        "sensors": [_state_sensor(one) for one in summary.sensors],
        "refraction": describe_refraction(summary.refraction),
        "scale": describe_scale(summary.refraction),
        "interruptions": state_interruptions(summary),
        "quality": _state_quality(summary.quality),
        "seats": [_describe_seat(seat) for seat in estimate.seats],
        "brought": None
        if brought is None or without_um is None
        else {
            "with_um": f"{_K * UM_PER_MM * brought.sigma_mm:.2f}",
            "without_um": f"{_K * without_um:.2f}",
        },
    }


def _state_quality(found: SampleQuality | None) -> str:
    """Empty where the tracker reports no quality."""
    if found is None:
        return ""
    share = "" if found.told == 1.0 else f", told of {100.0 * found.told:.0f} %"
    return (
        f"{found.mean:.2f} in the mean, one of twenty below {found.low:.2f}, as the "
        f"tracker tells it (1 is best){share}"
    )


def _state_sensor(one: ChannelFacts) -> tuple[str, ...]:
    name, _, unit = one.name.rpartition("_")
    if not one.readings:
        numbers = ("–",) * 4
    else:
        numbers = tuple(
            format_number(value, 2)
            for value in (one.mean, one.low, one.high, one.change)
        )
    used = "yes" if one.is_used else f"no: nothing for {one.hole_s:.0f} s"
    shown = f"{one.readings:,} in {one.rows:,} rows"
    return name, _UNITS[unit], *numbers, shown, used


def state_interruptions(summary: RunSummary) -> str:
    """Beam breaks, lost samples, searches, and repeated lines; empty for nothing."""
    found, said = summary.interruptions, list[str]()
    if found.breaks:
        times = "once" if found.breaks == 1 else f"{found.breaks} times"
        said.append(f"the beam was broken {times}, {found.broken_s:.1f} s in all")
    if found.gaps:
        places = "one place" if found.gaps == 1 else f"{found.gaps} places"
        said.append(f"{found.lost_samples:,} samples lost in {places}")
    if found.searches or found.found:
        tries = found.searches + found.found
        times = "once" if tries == 1 else f"{tries} times"
        said.append(f"the tracker searched {times} and found it {found.found} times")
    if summary.driven_again:
        said.append(f"driven twice: {', '.join(summary.driven_again)}")
    return "; ".join(said)


def _describe_seat(seat: SeatEstimate) -> View:
    shift = (UM_PER_MM * seat.shift_mm).tolist()
    half = (_K * UM_PER_MM * seat.sigma_mm).tolist()
    return {
        "name": seat.target.name,
        "shift_um": ", ".join(f"{value:.1f}" for value in shift),
        "half_um": ", ".join(f"{value:.2g}" for value in half),
        "against": " against the first target" if seat.target.on == "tool" else "",
    }


def _describe_run_residuals(run: RunFindings) -> View:
    noise, jitter = run.noise, run.noise.along_travel_um
    parts = (
        ("One sample, as the tracker states", noise.stated_um),
        ("One sample, white part found", noise.white_um),
        ("Correlated part found", noise.ou_um),
    )
    return {
        "summary": run.summary,
        "figure": draw_residuals(run),
        "noise": [
            (name, *(format_number(v, 2) for v in values)) for name, values in parts
        ],
        "distance_m": f"{noise.distance_mm / 1000.0:.2f}",
        "correlation_time_s": f"{noise.ou_time_s:.2g}",
        "along_um": None if jitter is None else f"{jitter:.2g}",
    }


def _describe_pose(run: RunFindings) -> View:
    sigma = np.sqrt(np.maximum(np.diag(run.estimate.pose_covariance), 0.0))
    scale = _K * np.repeat([UM_PER_MM, URAD_PER_RAD], 3)
    half = [f"{value:.2g}" for value in scale * sigma]
    station = run.estimate.pose.invert().translation_mm.tolist()
    return {
        "summary": run.summary,
        "station_mm": ", ".join(format_number(value) for value in station),
        "translation_um": ", ".join(half[:3]),
        "rotation_urad": ", ".join(half[3:]),
    }


def _state_feed(feed_mm_min: tuple[float, float] | None) -> str:
    if feed_mm_min is None:
        return ""
    return " to ".join(dict.fromkeys(f"{feed:,.0f}" for feed in feed_mm_min))
