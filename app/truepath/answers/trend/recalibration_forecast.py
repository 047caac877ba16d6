"""How far a machine will be off the tables in its control, and when that is too much.

The control has the tables of the last Run, as one that was compensated then: later
changes remain in the work. It is time to calibrate again as soon as a limit has been
exceeded with a chance of 5 %.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from truepath.estimation.over_time.drift import Drift
from truepath.estimation.over_time.drift_process import Course
from truepath.estimation.solve.extrapolation import Ranges
from truepath.files.units import UM_PER_MM
from truepath.kinematics.model import EstimatedModel
from truepath.kinematics.volumetric_map import compute_volumetric_gram
from truepath.results.error_tables import ErrorTables, build_error_tables

CHANCE = 0.05  # that the limit is exceeded, at which to calibrate again
_GRADES = ("certain", 0.95), ("likely", 0.75), ("possible", 0.0)
FEWEST_RUNS = 3  # two give a difference, but not its course
_STEPS = 64  # of the time that is looked ahead
_DRAWS = 16  # of each share
_FINE = 1e-7  # of the largest eigenvalue: shapes that no error over the travel shows


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
        state = "not-known" if runs < FEWEST_RUNS else "not-within-horizon"
        if limit is not None and runs >= FEWEST_RUNS:
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
