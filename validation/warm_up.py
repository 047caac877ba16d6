"""Machines that warm, followed by short Runs: tables over time, later, and when due.

    python validation/warm_up.py --worlds 20 --first-seed 1000

Each world is solved with all of its Runs, and with its first four alone.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from document import table, write_section
from judging import map_mm, table_deviations, true_map_mm, true_parameters, volume
from recordings import run_of
from warming_worlds import HOUR_S, WarmingWorld, draw_warming_world

from truepath.alignment.align import align_all
from truepath.answers.trend import ForecastModel
from truepath.estimation.checks.robust_estimate import estimate_checked
from truepath.estimation.solve.batch import Estimate
from truepath.estimation.solve.drift import Course, compute_common_basis, estimate_drift
from truepath.kinematics.coarse_model import build_run_models
from truepath.kinematics.model import MachineModel

DOCUMENT = Path(__file__).resolve().parent.parent / "docs" / "time.md"
USED = {"all, 6 to 10": 10, "the first 4": 4}
LATER_H, LIMITS_UM, HORIZON_H = (1.0, 3.0, 8.0), (1.0, 2.0, 4.0), 12.0
_STEPS = 49


@dataclass
class Tally:
    """What was seen over worlds, by what it is called."""

    values: dict[tuple[str, ...], list[float]] = field(
        default_factory=dict[tuple[str, ...], list[float]]
    )

    def add(self, *key: str, value: float) -> None:
        """Note a number."""
        self.values.setdefault(key, []).append(value)

    def mean(self, *key: str) -> float:
        """Return the mean of what was noted."""
        return float(np.mean(self.values[key]))

    def rms(self, *key: str) -> float:
        """Return the root mean square of what was noted."""
        return float(np.sqrt(np.mean(np.square(self.values[key]))))

    def get(self, *key: str) -> np.ndarray:
        """Return what was noted, which may be nothing."""
        return np.array(self.values.get(key, []))


@dataclass(frozen=True)
class Judge:
    """What is true of one world, and how far a statement is off."""

    world: WarmingWorld
    model: MachineModel

    def note(
        self,
        tally: Tally,
        key: tuple[str, ...],
        at_s: float,
        theta: np.ndarray,
        covariance: np.ndarray,
    ) -> None:
        """Note what tables leave of the truth at a time, and what their U holds."""
        within, truth = volume(self.model.machine), self.world.at(at_s)
        true = true_map_mm(within, truth)
        found, sigma = map_mm(within, self.model, theta, covariance)
        tally.add(*key, "left", value=1e3 * within.rms_length(true - found))
        tally.add(*key, "map", value=within.share(np.abs(true - found) < 2.0 * sigma))
        parameters = true_parameters(self.model, truth)
        off, own, _ = table_deviations(self.model, theta, covariance, parameters)
        tally.add(*key, "tables", value=float((np.abs(off) < 2.0 * own).mean()))

    def measure_off_um(self, at_s: float, theta: np.ndarray) -> float:
        """Return how far the machine is off the tables that its control has."""
        within = volume(self.model.machine)
        true = true_map_mm(within, self.world.at(at_s))
        found, _ = map_mm(within, self.model, theta, np.zeros(2 * theta.shape))
        return 1e3 * within.rms_length(true - found)


def judge_world(seed: int, tally: Tally) -> None:
    """Solve one world, and note how far everything stated is off."""
    world = draw_warming_world(seed)
    alone: list[Estimate] = []
    for recording in world.recordings:
        run = run_of(recording)
        (seen,) = align_all([run], [run.name])
        models = build_run_models(run.machine, [seen.at])
        alone.append(estimate_checked(models, [seen]).estimate)
    for k in _choose_runs(len(alone)):
        one = alone[k]
        own = Judge(world, one.model)
        own.note(tally, ("alone",), world.time_s[k], one.theta, one.covariance)
    for used, count in USED.items():
        _judge_used(world, alone[:count], used, tally)


def _choose_runs(count: int) -> tuple[int, int, int]:
    """Return the first Run, one in the middle and the last."""
    return 0, count // 2, count - 1


def _judge_used(
    world: WarmingWorld, alone: list[Estimate], used: str, tally: Tally
) -> None:
    basis = compute_common_basis(alone)
    judge, begin = Judge(world, basis.model), world.time_s[0]
    times = world.time_s[: len(alone)] - begin
    course = Course(times, np.zeros((len(times), 0)))
    drift = estimate_drift(basis, course)
    ahead = ForecastModel.of(drift, course)
    for k in _choose_runs(len(alone)):
        stated = drift.predict(ahead.course_of_run(k))
        judge.note(tally, (used, "runs"), begin + times[k], *stated)
    for hours in LATER_H:
        at_s = float(times[-1]) + HOUR_S * hours
        key = used, f"{hours:g} h"
        stated = drift.predict(ahead.course_at(at_s))
        judge.note(tally, key, begin + at_s, *stated)
        stays = judge.measure_off_um(begin + at_s, ahead.last)
        tally.add(*key, "stays", value=stays)
    _judge_due(judge, ahead, used, tally)


def _judge_due(judge: Judge, ahead: ForecastModel, used: str, tally: Tally) -> None:
    """Note when the machine is due, in truth and as stated, in h after the last Run."""
    begin, last = judge.world.time_s[0], float(ahead.runs.time_s[-1])
    hours = np.linspace(0.0, HORIZON_H, _STEPS)
    off = np.array(
        [judge.measure_off_um(begin + last + HOUR_S * h, ahead.last) for h in hours]
    )
    for limit in LIMITS_UM:
        beyond = np.flatnonzero(off > limit)
        true = float(hours[beyond[0]]) if len(beyond) else np.inf
        told = ahead.predict_exceedance(limit, HORIZON_H * HOUR_S)
        key = used, f"{limit:g} µm"
        tally.add(*key, "true", value=true)
        for name, at_s in (("due", told.due_s), ("expected", told.expected_s)):
            value = np.inf if at_s is None else (at_s - last) / HOUR_S
            tally.add(*key, name, value=value)


def write_tables(tally: Tally) -> None:
    """Write the tables of the page."""
    rows = [["one Run alone", *_state(tally, "alone")]]
    rows += [[f"together: {used}", *_state(tally, used, "runs")] for used in USED]
    head = ["tables from", "left µm", "tables in 2u", "map in 2u"]
    write_section("time-tables", table(head, rows), DOCUMENT)
    rows = [
        [
            f"{used}: {hours:g} h later",
            f"{tally.rms(used, f'{hours:g} h', 'stays'):.2f}",
            *_state(tally, used, f"{hours:g} h"),
        ]
        for used in USED
        for hours in LATER_H
    ]
    head = ["Runs", "the last tables stay, µm", "left µm", "tables in 2u", "map in 2u"]
    write_section("time-later", table(head, rows), DOCUMENT)
    rows = [
        [f"{used}: {limit:g} µm", *_state_due(tally, used, limit)]
        for used in USED
        for limit in LIMITS_UM
    ]
    head = [
        "Runs: limit",
        "exceeds within 12 h",
        "told due / cannot be said / below",
        "a chance of 5 % told after it",
        "stays below",
        "told due / cannot be said / below",
        "even chance over true time, median",
        "quartiles",
    ]
    write_section("time-due", table(head, rows), DOCUMENT)


def _state(tally: Tally, *key: str) -> list[str]:
    return [
        f"{tally.rms(*key, 'left'):.2f}",
        f"{tally.mean(*key, 'tables'):.1%}",
        f"{tally.mean(*key, 'map'):.1%}",
    ]


def _state_due(tally: Tally, used: str, limit: float) -> list[str]:
    key = used, f"{limit:g} µm"
    true, due, expected = (tally.get(*key, n) for n in ("true", "due", "expected"))
    step = HORIZON_H / (_STEPS - 1)
    exceeds = np.isfinite(true)
    late = exceeds & (due > true + step)
    both = exceeds & np.isfinite(expected) & (true > 0.0)
    ratio = ["", ""]
    if both.any():
        low, middle, high = np.quantile(
            expected[both] / true[both], [0.25, 0.5, 0.75]
        ).tolist()
        ratio = [f"{middle:.2f} ({both.sum()})", f"{low:.2f} to {high:.2f}"]
    below, is_due = np.isinf(due), np.isfinite(expected)
    answers = is_due, ~is_due & ~below, below
    told = [
        " / ".join(str(int((within & answer).sum())) for answer in answers)
        for within in (exceeds, ~exceeds)
    ]
    counts = [str(int(count.sum())) for count in (exceeds, late, ~exceeds)]
    return [counts[0], told[0], counts[1], counts[2], told[1], *ratio]


def main() -> None:
    """Judge worlds and write the tables after each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--worlds", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=1)
    options, _ = parser.parse_known_args()
    tally, begin = Tally(), time.perf_counter()
    for seed in range(options.first_seed, options.first_seed + options.worlds):
        judge_world(seed, tally)
        print(f"seed {seed}: {time.perf_counter() - begin:.0f} s", flush=True)
        write_tables(tally)  # it may be stopped


if __name__ == "__main__":
    main()
