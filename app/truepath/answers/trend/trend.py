"""A machine over time: its error tables at each of several Runs, and later.

Each Run is estimated alone; the course of each entry over all is in
`estimation.over_time.drift`, and when to calibrate again in
`recalibration_forecast`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float64

from truepath.alignment.align import align_all
from truepath.answers.shown.number_format import format_number
from truepath.answers.trend.recalibration_forecast import (
    CHANCE,
    ForecastModel,
    Quantiles,
    RecalibrationForecast,
    TablesAt,
)
from truepath.errors import BadInput
from truepath.estimation.checks.robust_estimate import CheckedEstimate, estimate_checked
from truepath.estimation.over_time.drift import Drift, estimate_drift
from truepath.estimation.over_time.drift_process import Course
from truepath.estimation.solve.common_basis import find_common_basis
from truepath.estimation.solve.extrapolation import Ranges
from truepath.files.bundle.machine_file import machine_to_json
from truepath.files.bundle.one_machine import TimedRun, order_in_time
from truepath.files.bundle.run import Run, RunSummary, number_names, summarize_run
from truepath.files.earlier.verdict import Verdict, verdict_json
from truepath.kinematics.coarse_model import build_run_models
from truepath.kinematics.machine.machine import Machine
from truepath.progress import Progress, ignore_progress
from truepath.results.error_tables import tables_json
from truepath.results.result_assessment import assess
from truepath_drivers.interfaces.records import TemperatureSamples

HOUR_S = 3600.0
HORIZON_S = 24.0 * HOUR_S
# Typical size of a state: what it moves an error motion by over the travel.
USUAL_UM = 10.0
SCHEMA = "trend/1"
NOT_TOLD = (
    "Shifts and turns of the whole volume between Runs, the growth of a spindle among "
    "them: the tracker's place is free in every Run.",
    "What happens within a Run: each counts as one moment, its middle.",
    "Changes of lost motion and of anything else that depends on the direction of "
    "approach.",
    "What has not begun yet: another use of the machine, a crash, a change of its "
    "heating. The course goes on as it was, and as halls usually do.",
)
_KEYS = {
    "quick": "quick_um",
    "slow": "slow_um",
    "quick_s": "quick_s",
    "slow_s": "slow_s",
    "walk": "walk_um_in_one_hour",
    "day": "day_um",
    "per_kelvin": "per_kelvin_um",
}


@dataclass(frozen=True, slots=True)
class TrendRequest:
    """Request for the time after the last Run; times are since that.

    at_s : the middle of each Run from any origin; None to take it from the clocks
    limit_um : root mean square over the travel that the machine may be off
    horizon_s : length of the forecast; later_s : when the tables are predicted
    celsius : constant temperatures from the last Run on, by sensor; where none are
        given, temperatures are not used
    """

    at_s: tuple[float, ...] | None = None
    limit_um: float | None = None
    horizon_s: float = HORIZON_S
    later_s: tuple[float, ...] = ()
    celsius: dict[str, float] | None = None

    @staticmethod
    def of(asked: Mapping[str, Any]) -> TrendRequest:
        """From JSON, times in hours; missing keys have the defaults."""
        at_h, horizon_h = asked.get("at_h"), asked.get("horizon_h")
        return TrendRequest(
            None if at_h is None else tuple(HOUR_S * hours for hours in at_h),
            asked.get("limit_um"),
            HORIZON_S if horizon_h is None else HOUR_S * horizon_h,
            tuple(HOUR_S * hours for hours in asked.get("later_h") or ()),
            asked.get("temperature_degC"),
        )


@dataclass(frozen=True, slots=True)
class Trend:
    """A machine over several Runs.

    sensors : temperatures that were used
    sizes : of the states, in µm for µm-entries, and time constants in s
    """

    machine: Machine
    runs: tuple[RunSummary, ...]
    verdict: Verdict
    sensors: tuple[str, ...]
    sizes: dict[str, Quantiles]
    at_runs: tuple[TablesAt, ...]
    later: tuple[TablesAt, ...]
    outlook: RecalibrationForecast


def follow_machine(
    runs: Sequence[Run],
    question: TrendRequest,
    *,
    on_progress: Progress = ignore_progress,
) -> Trend:
    """Estimate each Run, then the course over all.

    Raises BadInput if a Run is given twice, if they are not of one machine with the
    same targets, or if their order of time is not known.
    """
    names = number_names([run.name for run in runs])
    timed = [TimedRun.of(run, name) for run, name in zip(runs, names, strict=True)]
    ordered = order_in_time(timed, question.at_s)
    machine = ordered.machine
    since_s = np.array(ordered.time_s) - ordered.time_s[0]
    sensors, course = _make_course(runs, since_s, question)
    found: list[CheckedEstimate] = []
    for number, run in enumerate(runs):
        on_progress(0.8 * number / len(runs), "estimating")
        found.append(_estimate(replace(run, machine=machine), names[number]))
    on_progress(0.8, "following")
    basis = find_common_basis([one.estimate for one in found])
    drift = estimate_drift(basis, course)
    summaries = tuple(
        replace(summarize_run(run), name=name)
        for run, name in zip(runs, names, strict=True)
    )
    on_progress(0.9, "predicting")
    ahead = ForecastModel.of(drift, course)
    ranges = _join_ranges([one.estimate.measured for one in found])
    return Trend(
        machine,
        summaries,
        _assess(found, names),
        sensors,
        _state_sizes(drift, bool(sensors)),
        tuple(
            ahead.compute_tables(ahead.course_of_run(k), names[k], ranges)
            for k in range(len(runs))
        ),
        tuple(
            ahead.compute_tables(
                ahead.course_at(float(since_s[-1]) + later_s), "", ranges
            )
            for later_s in question.later_s
        ),
        ahead.predict_exceedance(question.limit_um, question.horizon_s),
    )


def _estimate(run: Run, name: str) -> CheckedEstimate:
    observed = align_all([run], [name])
    models = build_run_models(run.machine, [one.at for one in observed])
    return estimate_checked(models, observed)


def _assess(found: Sequence[CheckedEstimate], names: Sequence[str]) -> Verdict:
    return Verdict(
        tuple(
            replace(reason, run=name)
            for one, name in zip(found, names, strict=True)
            for reason in assess(one, [name]).reasons
        )
    )


def _make_course(
    runs: Sequence[Run],
    since_s: Float64[np.ndarray, " n"],
    question: TrendRequest,
) -> tuple[tuple[str, ...], Course]:
    """The sensors used and the Runs' times with their mean temperatures.

    Temperatures are relative to the constant ones after the last Run.
    """
    if not question.celsius:
        return (), Course(since_s, np.zeros((len(runs), 0)))
    rows: list[list[float]] = []
    for run in runs:
        known = {} if run.temperature is None else _find_means(run.temperature)
        missing = [name for name in question.celsius if name not in known]
        if missing:
            raise BadInput(f"{run.name} has no temperature {missing[0]}: leave it out")
        rows.append([known[name] - own for name, own in question.celsius.items()])
    return tuple(question.celsius), Course(since_s, np.array(rows))


def _find_means(told: TemperatureSamples) -> dict[str, float]:
    columns = (told.celsius[:, k] for k in range(len(told.names)))
    return {
        name: float(np.nanmean(shown))
        for name, shown in zip(told.names, columns, strict=True)
        if np.isfinite(shown).any()
    }


def _join_ranges(ranges: Sequence[Ranges]) -> Ranges:
    return {
        name: (
            max(one[name][0] for one in ranges),
            min(one[name][1] for one in ranges),
        )
        for name in ranges[0]
        if all(name in one for one in ranges)
    }


def _state_sizes(drift: Drift, warms: bool) -> dict[str, Quantiles]:
    sizes = drift.list_sizes()
    scales = {"quick": USUAL_UM, "slow": USUAL_UM, "quick_s": 1.0, "slow_s": 1.0}
    scales |= {"walk": USUAL_UM, "day": USUAL_UM}
    if warms:
        scales["per_kelvin"] = USUAL_UM
    return {
        name: Quantiles.of(scale * np.array([getattr(one, name) for one in sizes]))
        for name, scale in scales.items()
    }


def trend_json(trend: Trend) -> dict[str, Any]:
    """The whole content of `trend.json`."""
    return {
        "schema": SCHEMA,
        "machine": machine_to_json(trend.machine),
        "verdict": verdict_json(trend.verdict),
        "runs": [
            {
                "name": at.name,
                "sha256": run.digest,
                "temperature_degC": run.temperature_degc,
                **_encode_tables(trend, at),
            }
            for run, at in zip(trend.runs, trend.at_runs, strict=True)
        ],
        "later": [_encode_tables(trend, at) for at in trend.later],
        "states": {_KEYS[name]: asdict(size) for name, size in trend.sizes.items()},
        "sensors": list(trend.sensors),
        "outlook": _encode_outlook(trend.outlook),
        "not_told": list(NOT_TOLD),
    }


def describe_outlook(outlook: RecalibrationForecast) -> str:
    """One sentence on when to calibrate again."""
    if outlook.state == "not-known":
        return "When to calibrate again is not known: too few Runs, give three or more."
    if outlook.limit_um is None:
        return "No limit is stated, so nothing is said of when to calibrate again."
    limit = f"{outlook.limit_um:g} µm"
    hours = f"{format_number(float(outlook.time_s[-1]) / HOUR_S)} h"
    if outlook.due_s is None:
        return f"Not due: the machine stays below {limit} up to {hours}."
    if outlook.state == "already":
        return (
            f"Already: what is not known at the last Run may exceed {limit}. Measure "
            "more, or state a wider limit."
        )
    due = f"{format_number(outlook.due_s / HOUR_S)} h"
    chance = f"{100.0 * CHANCE:.0f} %"
    if outlook.expected_s is None:
        end = f"{100.0 * (outlook.exceeded or 0.0):.0f} %"
        return (
            f"The machine stays below {limit} up to {due}. Later cannot be said: the "
            f"chance to exceed it reaches {end} by {hours}. Measure once more by {due}."
        )
    expected = f"{format_number(outlook.expected_s / HOUR_S)} h"
    return (
        f"Calibrate again at {due} ({outlook.grade}): a chance of {chance} to exceed "
        f"{limit} by then, an even chance by {expected}."
    )


def _encode_tables(trend: Trend, at: TablesAt) -> dict[str, Any]:
    tables = tables_json(at.tables, (), "none", {}, trend.machine)
    del tables["direction"], tables["measured_range"]
    hours = at.time_s / HOUR_S
    return {"time_h": hours, "change_um": asdict(at.change_um), **tables}


def _encode_outlook(outlook: RecalibrationForecast) -> dict[str, Any]:
    due, expected = outlook.due_s, outlook.expected_s
    return {
        "state": outlook.state,
        "grade": outlook.grade,
        "sentence": describe_outlook(outlook),
        "limit_um": outlook.limit_um,
        "chance": CHANCE,
        "exceeded": outlook.exceeded,
        "due_h": None if due is None else due / HOUR_S,
        "expected_h": None if expected is None else expected / HOUR_S,
        "time_h": (outlook.time_s / HOUR_S).tolist(),
        "median_um": outlook.median_um.tolist(),
        "high_um": outlook.high_um.tolist(),
    }
