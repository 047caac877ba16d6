"""A machine over time: its error tables at each of several Runs, and later.

Each Run is estimated alone; the course of each entry over all is in
`estimation.solve.drift`. The control has the tables of the last Run, as one that
was compensated then: later changes remain in the work. It is time to calibrate again as
soon as a limit has been exceeded with a chance of 5 %.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float64

from truepath.alignment.align import align_all
from truepath.errors import BadInput
from truepath.estimation.checks.robust_estimate import CheckedEstimate, estimate_checked
from truepath.estimation.solve.drift import (
    Course,
    Drift,
    compute_common_basis,
    estimate_drift,
)
from truepath.estimation.solve.extrapolation import Ranges
from truepath.files.bundle.one_machine import TimedRun, order_in_time
from truepath.files.bundle.run import Run, RunSummary, number_names, summarize_run
from truepath.files.earlier.verdict import Verdict
from truepath.files.units import UM_PER_MM
from truepath.kinematics.coarse_model import build_run_models
from truepath.kinematics.machine.machine import Machine
from truepath.kinematics.model import EstimatedModel
from truepath.kinematics.volumetric_map import compute_volumetric_gram
from truepath.progress import Progress, ignore_progress
from truepath.results.error_tables import ErrorTables, build_error_tables
from truepath.results.result_assessment import assess

CHANCE = 0.05  # that the limit is exceeded, at which to calibrate again
_GRADES = ("certain", 0.95), ("likely", 0.75), ("possible", 0.0)
_FEWEST_RUNS = 3  # two give a difference, but not its course
_STEPS = 64  # of the time that is looked ahead
_DRAWS = 16  # of each share
_FINE = 1e-7  # of the largest eigenvalue: shapes that no error over the travel shows
HOUR_S = 3600.0
_HORIZON_S = 24.0 * HOUR_S
# Typical size of a state: what it moves an error motion by over the travel.
_TYPICAL_UM = 10.0


@dataclass(frozen=True, slots=True)
class Quantiles:
    """Median with its 95 % interval."""

    median: float
    low: float
    high: float

    @staticmethod
    def of(values: Float64[np.ndarray, " n"]) -> Quantiles:
        """2.5 %, 50 % and 97.5 % of draws of equal weight."""
        low, median, high = np.quantile(values, [0.025, 0.5, 0.975]).tolist()
        return Quantiles(median, low, high)


@dataclass(frozen=True, slots=True)
class TablesAt:
    """The machine at one time: from all Runs, with standard uncertainties.

    time_s : after the first Run; name : of the Run, empty for what is predicted
    change_um : difference from the tables of the last Run, root mean square over the
        travel
    """

    time_s: float
    name: str
    tables: ErrorTables
    change_um: Quantiles


@dataclass(frozen=True, slots=True)
class RecalibrationForecast:
    """Predicted difference of the machine from the tables of the last Run.

    time_s : (n,) after the first Run, from the last Run on
    median_um, high_um : (n,) root mean square over the travel, 50 and 95 % of courses
    state : `not-within-horizon` where the chance that the limit is exceeded stays below
        5 %; `due` where it reaches one half; `cannot-be-said` where it ends between;
        `already` where the uncertainty at the last Run alone is too much; `not-known`
        where Runs are too few
    due_s : when the chance that the limit has been exceeded reaches 5 %
    expected_s : when it reaches one half, if it does
    exceeded : the chance at the end, if a limit is stated and Runs are enough
    """

    time_s: Float64[np.ndarray, " n"]
    median_um: Float64[np.ndarray, " n"]
    high_um: Float64[np.ndarray, " n"]
    limit_um: float | None
    state: str
    due_s: float | None
    expected_s: float | None
    exceeded: float | None

    @property
    def grade(self) -> str | None:
        """Certainty of `due` or `not-within-horizon`; None of other states."""
        if self.exceeded is None or self.state not in ("due", "not-within-horizon"):
            return None
        chance = max(self.exceeded, 1.0 - self.exceeded)
        return next(name for name, least in _GRADES if chance >= least)


@dataclass(frozen=True, slots=True)
class ForecastModel:
    """Estimated courses, relative to the tables of the last Run.

    last : parameters that the control has; root : (p, r) whose product with parameters
        is a vector as long as the error's root mean square over the travel, mm
    """

    drift: Drift
    runs: Course
    last: Float64[np.ndarray, " p"]
    root: Float64[np.ndarray, "p r"]

    @staticmethod
    def of(drift: Drift, runs: Course) -> ForecastModel:
        """With the tables of the last Run as those that the control has."""
        value, vector = np.linalg.eigh(compute_volumetric_gram(drift.data.basis.model))
        kept = value > _FINE * value[-1]
        root = vector[:, kept] * np.sqrt(value[kept])
        last, _ = drift.predict(Course(runs.time_s[-1:], runs.celsius[-1:]))
        return ForecastModel(drift, runs, last, root)

    def course_of_run(self, run: int) -> Course:
        """Time and temperatures of a Run, counted from 0."""
        return Course(self.runs.time_s[run : run + 1], self.runs.celsius[run : run + 1])

    def course_at(self, *time_s: float) -> Course:
        """After the last Run, at the constant temperatures."""
        celsius = np.zeros((len(time_s), self.runs.celsius.shape[1]))
        return Course(np.array(time_s), celsius)

    def compute_tables(self, at: Course, name: str, measured: Ranges) -> TablesAt:
        """Tables and change at one time; name : empty of a prediction"""
        model = self.drift.data.basis.model
        estimated = EstimatedModel(model, *self.drift.predict(at))
        change = Quantiles.of(self._measure_change_um(at)[:, 0])
        tables = build_error_tables(estimated, measured)
        return TablesAt(float(at.time_s[0]), name, tables, change)

    def predict_exceedance(
        self, limit: float | None, horizon_s: float
    ) -> RecalibrationForecast:
        """Courses up to the horizon, and when the difference exceeds a limit in µm."""
        begin, runs = float(self.runs.time_s[-1]), len(self.runs.time_s)
        at = self.course_at(*(begin + np.linspace(0.0, horizon_s, _STEPS)).tolist())
        off_um = self._measure_change_um(at)
        median, high = np.quantile(off_um, [0.5, 1.0 - CHANCE], axis=0)
        due = expected = end = None
        state = "not-known" if runs < _FEWEST_RUNS else "not-within-horizon"
        if limit is not None and runs >= _FEWEST_RUNS:
            exceeded = np.maximum.accumulate(off_um > limit, axis=1).mean(axis=0)
            due = _find_crossing(at.time_s, exceeded, CHANCE)
            expected = _find_crossing(at.time_s, exceeded, 0.5)
            end = float(exceeded[-1])
            if due is not None:
                state = "cannot-be-said" if expected is None else "due"
                state = "already" if due <= begin else state
        return RecalibrationForecast(
            at.time_s, median, high, limit, state, due, expected, end
        )

    def _measure_change_um(self, at: Course) -> Float64[np.ndarray, "c t"]:
        drawn = self.drift.draw(at, self.root, _DRAWS)
        off = drawn - self.last @ self.root
        return UM_PER_MM * np.linalg.norm(off, axis=2)


def _find_crossing(
    time_s: Float64[np.ndarray, " n"], share: Float64[np.ndarray, " n"], level: float
) -> float | None:
    """Interpolated between steps; share : never falls"""
    k = int(np.searchsorted(share, level))
    if k == len(share):
        return None
    if k == 0:
        return float(time_s[0])
    part = (level - share[k - 1]) / (share[k] - share[k - 1])
    return float(time_s[k - 1] + part * (time_s[k] - time_s[k - 1]))


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
    horizon_s: float = _HORIZON_S
    later_s: tuple[float, ...] = ()
    celsius: dict[str, float] | None = None

    @staticmethod
    def of(content: Mapping[str, Any]) -> TrendRequest:
        """From JSON, times in hours; missing keys have the defaults."""
        at_h, horizon_h = content.get("at_h"), content.get("horizon_h")
        return TrendRequest(
            None if at_h is None else tuple(HOUR_S * hours for hours in at_h),
            content.get("limit_um"),
            _HORIZON_S if horizon_h is None else HOUR_S * horizon_h,
            tuple(HOUR_S * hours for hours in content.get("later_h") or ()),
            content.get("temperature_degC"),
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
    forecast: RecalibrationForecast


def follow_machine(
    runs: Sequence[Run],
    request: TrendRequest,
    *,
    on_progress: Progress = ignore_progress,
) -> Trend:
    """Estimate each Run, then the course over all.

    Raises BadInput if a Run is given twice, if they are not of one machine with the
    same targets, or if their order of time is not known.
    """
    names = number_names([run.name for run in runs])
    timed = [TimedRun.of(run, name) for run, name in zip(runs, names, strict=True)]
    ordered = order_in_time(timed, request.at_s)
    machine = ordered.machine
    since_s = np.array(ordered.time_s) - ordered.time_s[0]
    sensors, course = _make_course(runs, since_s, request)
    found: list[CheckedEstimate] = []
    for number, run in enumerate(runs):
        on_progress(0.8 * number / len(runs), "estimating")
        of_machine = replace(run, machine=machine)
        observed = align_all([of_machine], [names[number]])
        models = build_run_models(machine, [one.at for one in observed])
        found.append(estimate_checked(models, observed))
    on_progress(0.8, "following")
    basis = compute_common_basis([one.estimate for one in found])
    drift = estimate_drift(basis, course)
    summaries = tuple(
        replace(summarize_run(run), name=name)
        for run, name in zip(runs, names, strict=True)
    )
    on_progress(0.9, "predicting")
    ahead = ForecastModel.of(drift, course)
    ranges = intersect_ranges([one.estimate.measured for one in found])
    return Trend(
        machine,
        summaries,
        Verdict(
            tuple(
                replace(reason, run=name)
                for one, name in zip(found, names, strict=True)
                for reason in assess(one, [name]).reasons
            )
        ),
        sensors,
        _compute_sizes(drift, bool(sensors)),
        tuple(
            ahead.compute_tables(ahead.course_of_run(k), names[k], ranges)
            for k in range(len(runs))
        ),
        tuple(
            ahead.compute_tables(
                ahead.course_at(float(since_s[-1]) + later_s), "", ranges
            )
            for later_s in request.later_s
        ),
        ahead.predict_exceedance(request.limit_um, request.horizon_s),
    )


def _make_course(
    runs: Sequence[Run], since_s: Float64[np.ndarray, " n"], request: TrendRequest
) -> tuple[tuple[str, ...], Course]:
    """The sensors used and the Runs' times with their mean temperatures.

    Temperatures are relative to the constant ones after the last Run.
    """
    if not request.celsius:
        return (), Course(since_s, np.zeros((len(runs), 0)))
    rows: list[list[float]] = []
    for run in runs:
        known: dict[str, float] = {}
        if run.temperature is not None:
            for k, name in enumerate(run.temperature.names):
                celsius = run.temperature.celsius[:, k]
                if np.isfinite(celsius).any():
                    known[name] = float(np.nanmean(celsius))
        missing = [name for name in request.celsius if name not in known]
        if missing:
            raise BadInput(f"{run.name} has no temperature {missing[0]}: leave it out")
        rows.append([known[name] - own for name, own in request.celsius.items()])
    return tuple(request.celsius), Course(since_s, np.array(rows))


def intersect_ranges(ranges: Sequence[Ranges]) -> Ranges:
    """Of the axes that all have."""
    return {
        name: (max(one[name][0] for one in ranges), min(one[name][1] for one in ranges))
        for name in ranges[0]
        if all(name in one for one in ranges)
    }


def _compute_sizes(drift: Drift, warms: bool) -> dict[str, Quantiles]:
    sizes = drift.list_sizes()
    names = ["quick", "slow", "quick_s", "slow_s", "walk", "day"]
    names += ["per_kelvin"] * warms
    return {
        name: Quantiles.of(scale * np.array([getattr(one, name) for one in sizes]))
        for name in names
        for scale in [1.0 if name.endswith("_s") else _TYPICAL_UM]
    }
