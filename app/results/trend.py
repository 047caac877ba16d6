"""A machine over time: its error tables at each of several Runs, and later.

Each Run is estimated alone; what all tell together of the course of each entry is in
`estimation.drift`. Later the machine is held against the tables of the last Run, as a
control has them that was compensated then: what has come since is left in the work. It
is time to calibrate again as soon as this exceeds a limit with a chance of 5 %.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float64

from app.alignment.align import align_all
from app.errors import BadInput
from app.estimation.common_basis import find_common_basis
from app.estimation.disturbances import CheckedEstimate, estimate_checked
from app.estimation.drift import Drift, estimate_drift
from app.estimation.drift_course import Course
from app.estimation.extrapolation import Ranges
from app.files.one_machine import one_machine
from app.files.run import Run, RunSummary, number_names, summarize_run
from app.files.units import UM_PER_MM
from app.files.verdict import Verdict
from app.kinematics.coarse_model import build_run_models
from app.kinematics.estimated_model import EstimatedModel
from app.kinematics.machine import Machine
from app.kinematics.volumetric_map import compute_volumetric_gram
from app.progress import Progress, ignore_progress
from app.results.error_tables import ErrorTables, build_error_tables
from app.results.verdict import judge

CHANCE = 0.05  # that the limit is exceeded, at which to calibrate again
FEWEST_RUNS = 3  # two tell a difference, and nothing of its course
_STEPS = 64  # of the time that is looked ahead
_DRAWS = 16  # of each share
HOUR_S = 3600.0
# Usual size of a state: what it moves an error motion by over the travel.
USUAL_UM = 10.0


@dataclass(frozen=True, slots=True)
class Question:
    """What is asked of the time after the last Run; times are since that.

    limit_um : root mean square over the travel that the machine may be off
    horizon_s : how far to look; later_s : when the tables are predicted
    celsius : temperatures that stay from the last Run on, by sensor; where none are
        given, temperatures are not used
    """

    limit_um: float | None = None
    horizon_s: float = 24.0 * HOUR_S
    later_s: tuple[float, ...] = ()
    celsius: dict[str, float] | None = None


@dataclass(frozen=True, slots=True)
class Quantiles:
    """Median of a number with its 95 % interval."""

    median: float
    low: float
    high: float

    @staticmethod
    def of(values: Float64[np.ndarray, " n"]) -> Quantiles:
        """Return those of equal draws."""
        low, median, high = np.quantile(values, [0.025, 0.5, 0.975]).tolist()
        return Quantiles(median, low, high)


@dataclass(frozen=True, slots=True)
class TablesAt:
    """The machine at one time: from all Runs, with standard uncertainties.

    time_s : after the first Run; name : of the Run, empty for what is predicted
    change_um : by how much it is off the tables of the last Run, root mean square over
        the travel
    """

    time_s: float
    name: str
    tables: ErrorTables
    change_um: Quantiles


@dataclass(frozen=True, slots=True)
class Outlook:
    """How far the machine will be off the tables of the last Run.

    time_s : (n,) after the first Run, from the last Run on
    median_um, high_um : (n,) root mean square over the travel, 50 and 95 % of courses
    state : `due`, `not-within-horizon`, `already` where what is not known at the last
        Run is too much by itself, or `not-known` where Runs are too few
    due_s : when the chance that the limit has been exceeded reaches 5 %
    expected_s : when it reaches one half, if it does
    """

    time_s: Float64[np.ndarray, " n"]
    median_um: Float64[np.ndarray, " n"]
    high_um: Float64[np.ndarray, " n"]
    limit_um: float | None
    state: str
    due_s: float | None
    expected_s: float | None


@dataclass(frozen=True, slots=True)
class Trend:
    """What several Runs say of a machine over time.

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
    outlook: Outlook


def follow_machine(
    runs: Sequence[Run],
    time_s: Sequence[float],
    question: Question,
    *,
    on_progress: Progress = ignore_progress,
) -> Trend:
    """Follow a machine over Runs.

    time_s : of the middle of each Run, in their order

    Raises BadInput if the Runs are not of one machine with the same targets, or their
    times do not increase.
    """
    names = number_names([run.name for run in runs])
    since_s = _check_times(time_s, len(runs))
    machine = one_machine([run.machine for run in runs], names)
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
    ahead = _LookAhead.of(drift, course)
    ranges = _join_ranges([one.estimate.measured for one in found])
    return Trend(
        machine,
        summaries,
        _judge(found, names),
        sensors,
        _state_sizes(drift, bool(sensors)),
        tuple(ahead.state(ahead.at_run(k), names[k], ranges) for k in range(len(runs))),
        tuple(
            ahead.state(ahead.at(float(since_s[-1]) + later_s), "", ranges)
            for later_s in question.later_s
        ),
        ahead.look(question, len(runs)),
    )


def _estimate(run: Run, name: str) -> CheckedEstimate:
    """Estimate one Run alone."""
    observed = align_all([run], [name])
    models = build_run_models(run.machine, [one.at.offset_mm for one in observed])
    return estimate_checked(models, observed)


def _judge(found: Sequence[CheckedEstimate], names: Sequence[str]) -> Verdict:
    """Return what the Runs say of themselves, each by its name."""
    return Verdict(
        tuple(
            replace(reason, run=name)
            for one, name in zip(found, names, strict=True)
            for reason in judge(one, [name]).reasons
        )
    )


def _check_times(time_s: Sequence[float], runs: int) -> Float64[np.ndarray, " n"]:
    times = np.array(time_s, float)
    if len(times) != runs:
        raise BadInput(f"{len(times)} times are given for {runs} Runs: one for each")
    if runs < 2:
        raise BadInput("one Run tells nothing of time: give two at least")
    if not (np.diff(times) > 0.0).all():
        raise BadInput("the times of the Runs do not increase: sort the Runs by time")
    return times - times[0]


def _make_course(
    runs: Sequence[Run],
    since_s: Float64[np.ndarray, " n"],
    question: Question,
) -> tuple[tuple[str, ...], Course]:
    """Return the sensors used and the Runs' times with their mean temperatures.

    Temperatures are stated from those that stay after the last Run.
    """
    if not question.celsius:
        return (), Course(since_s, np.zeros((len(runs), 0)))
    rows: list[list[float]] = []
    for run in runs:
        told = run.temperature
        known = {}
        if told is not None:
            known = dict(zip(told.names, told.celsius.mean(axis=0), strict=True))
        missing = [name for name in question.celsius if name not in known]
        if missing:
            raise BadInput(f"{run.name} has no temperature {missing[0]}: leave it out")
        rows.append([known[name] - own for name, own in question.celsius.items()])
    return tuple(question.celsius), Course(since_s, np.array(rows))


def _join_ranges(ranges: Sequence[Ranges]) -> Ranges:
    """Return of each axis what every Run has measured."""
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


@dataclass(frozen=True, slots=True)
class _LookAhead:
    """Estimated courses, held against the tables of the last Run.

    last : parameters that the control has; root : (p, r) whose product with parameters
        is a vector as long as the error's root mean square over the travel, mm
    """

    drift: Drift
    runs: Course
    last: Float64[np.ndarray, " p"]
    root: Float64[np.ndarray, "p r"]

    @staticmethod
    def of(drift: Drift, runs: Course) -> _LookAhead:
        value, vector = np.linalg.eigh(compute_volumetric_gram(drift.data.basis.model))
        kept = value > 1e-12 * value[-1]
        root = vector[:, kept] * np.sqrt(value[kept])
        last, _ = drift.predict(Course(runs.time_s[-1:], runs.celsius[-1:]))
        return _LookAhead(drift, runs, last, root)

    def at_run(self, run: int) -> Course:
        """Return the time of a Run."""
        return Course(self.runs.time_s[run : run + 1], self.runs.celsius[run : run + 1])

    def at(self, *time_s: float) -> Course:
        """Return later times, at the temperatures that stay."""
        celsius = np.zeros((len(time_s), self.runs.celsius.shape[1]))
        return Course(np.array(time_s), celsius)

    def state(self, at: Course, name: str, measured: Ranges) -> TablesAt:
        """Return the machine at one time."""
        model = self.drift.data.basis.model
        estimated = EstimatedModel(model, *self.drift.predict(at))
        change = Quantiles.of(self._measure_change_um(at)[:, 0])
        tables = build_error_tables(estimated, measured)
        return TablesAt(float(at.time_s[0]), name, tables, change)

    def look(self, question: Question, runs: int) -> Outlook:
        """Return when the machine is off by more than the limit."""
        begin = float(self.runs.time_s[-1])
        at = self.at(*(begin + np.linspace(0.0, question.horizon_s, _STEPS)).tolist())
        off_um = self._measure_change_um(at)
        median, high = np.quantile(off_um, [0.5, 1.0 - CHANCE], axis=0)
        limit, due, expected = question.limit_um, None, None
        state = "not-known" if runs < FEWEST_RUNS else "not-within-horizon"
        if limit is not None and runs >= FEWEST_RUNS:
            exceeded = np.maximum.accumulate(off_um > limit, axis=1).mean(axis=0)
            due = _find_crossing(at.time_s, exceeded, CHANCE)
            expected = _find_crossing(at.time_s, exceeded, 0.5)
            if due is not None:
                state = "already" if due <= begin else "due"
        return Outlook(at.time_s, median, high, limit, state, due, expected)

    def _measure_change_um(self, at: Course) -> Float64[np.ndarray, "c t"]:
        """Return how far drawn courses are off the tables of the last Run."""
        off = (self.drift.draw(at, _DRAWS) - self.last) @ self.root
        return UM_PER_MM * np.linalg.norm(off, axis=2)


def _find_crossing(
    time_s: Float64[np.ndarray, " n"], share: Float64[np.ndarray, " n"], level: float
) -> float | None:
    """Return when a share that never falls reaches a level, between steps by line."""
    k = int(np.searchsorted(share, level))
    if k == len(share):
        return None
    if k == 0:
        return float(time_s[0])
    part = (level - share[k - 1]) / (share[k] - share[k - 1])
    return float(time_s[k - 1] + part * (time_s[k] - time_s[k - 1]))


def find_times(runs: Sequence[Run]) -> list[float]:
    """Return the middle of each Run on the tracker's clock.

    Raises BadInput if the clock has begun anew between two Runs.
    """
    spans = [run.tracker.device_time_s[[0, -1]].tolist() for run in runs]
    for before, after in pairwise(spans):
        if after[0] <= before[1]:
            raise BadInput(
                "the tracker's clock has begun anew between the Runs, so that their "
                "times are not known: state them (--at)"
            )
    return [0.5 * (first + last) for first, last in spans]
