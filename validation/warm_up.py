"""Machines that warm, followed by short Runs: tables over time, later, and when due.

    python validation/warm_up.py --worlds 20 --first-seed 1000

Each world is solved with all of its Runs, and with its first four alone.

Seven bodies exchange heat with each other and with the air, which has a day of its own:
the drives and scales of three axes, spindle, front and back of the column, bed. Scales
grow, the column bends as its front is warmer than its back, and twists a little; the
spindle grows, which shifts the volume as a whole. Nothing of it settles with one time
constant, and no temperature is that of what grows.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Self

import numpy as np
from document import table, write_section
from judging import map_mm, table_deviations, true_map_mm, true_parameters, volume
from recordings import CHAINS, machine_content, plan_program, random_air, run_of

from truepath.alignment.align import align_all
from truepath.answers.trend import ForecastModel
from truepath.estimation.checks.robust_estimate import estimate_checked
from truepath.estimation.solve.batch import Estimate
from truepath.estimation.solve.drift import Course, compute_common_basis, estimate_drift
from truepath.kinematics.coarse_model import build_run_models
from truepath.kinematics.model import MachineModel
from truepath_simulators.hidden.effect import HiddenEffect, Occasion
from truepath_simulators.hidden.motion import Motion
from truepath_simulators.machine.random_machine import random_machine
from truepath_simulators.machine.tracker_head import TrackerClock
from truepath_simulators.machine.truth_machine import TruthMachine
from truepath_simulators.machine_file import MachineFile, parse_machine
from truepath_simulators.worlds import synthetic
from truepath_simulators.worlds.recording import Recording

HOUR_S = 3600.0
_STEP_S, _END_S = 20.0, 30.0 * HOUR_S
_X, _Y, _Z, _SPINDLE, _FRONT, _BACK, _BED = range(7)
_LINES, _FEED_MM_MIN, _RATE_HZ = 14, 7000.0, 100


@dataclass(frozen=True, slots=True)
class HeatNetwork:
    """Bodies with capacity (J/K), losses to air and between them (W/K), and heat (W).

    day_k : half the swing of the air in a day
    """

    capacity: np.ndarray
    loss: np.ndarray
    between: np.ndarray
    heat: np.ndarray
    day_k: float
    day_phase: float

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Self:
        """Draw bodies that settle in a quarter of an hour to five hours."""
        rise = np.append(rng.uniform(0.5, 10.0, 3), [rng.uniform(5.0, 20.0), 0, 0, 0])
        hours = rng.uniform(
            [0.25, 0.25, 0.25, 0.15, 1.0, 1.5, 3.0], [1.2, 1.2, 1.2, 0.5, 2.5, 3.5, 5.0]
        )
        loss = np.ones(7)
        between = np.zeros((7, 7))
        for one, other, share in (
            (_SPINDLE, _FRONT, rng.uniform(0.1, 0.3)),
            (_FRONT, _BACK, rng.uniform(0.3, 0.8)),
            (_X, _BED, rng.uniform(0.1, 0.4)),
            (_Y, _BED, rng.uniform(0.1, 0.4)),
        ):
            between[one, other] = between[other, one] = share
        phase = float(rng.uniform(0.0, 2.0 * np.pi))
        day = float(rng.uniform(0.2, 1.0))
        return cls(HOUR_S * hours, loss, between, rise * loss, day, phase)

    def compute_rises(self) -> tuple[np.ndarray, np.ndarray]:
        """Return times and temperatures above the begin, (n,) and (n, 7)."""
        time_s = np.arange(0.0, _END_S, _STEP_S)
        day = 2.0 * np.pi * time_s / (24.0 * HOUR_S) + self.day_phase
        air = self.day_k * (np.sin(day) - np.sin(self.day_phase))
        rise = np.zeros((len(time_s), 7))
        for k in range(1, len(time_s)):
            now = rise[k - 1]
            flow = self.heat + self.loss * (air[k - 1] - now)
            flow += self.between @ now - self.between.sum(axis=1) * now
            rise[k] = now + _STEP_S * flow / self.capacity
        return time_s, rise


@dataclass(frozen=True)
class Warming(HiddenEffect):
    """What a network of heat does to the joints, from some time after its begin."""

    name = "warming"
    in_catalogue = False
    network: HeatNetwork
    per_k: tuple[float, ...]
    depth_mm: float
    twist: float
    begin_s: float = 0.0

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Draw expansion, depth of the column and twist; of a size of its own."""
        del occasion
        return cls(
            HeatNetwork.draw(rng),
            tuple(rng.uniform(8e-6, 12e-6, 4).tolist()),
            float(rng.uniform(250.0, 600.0)),
            float(rng.uniform(-0.3, 0.3)),
        )

    def parameters(self, clock: TrackerClock) -> dict[str, float]:
        """Return how deep the column is: the heat has no short form."""
        del clock
        return {"depth_mm": self.depth_mm}

    @cached_property
    def rises(self) -> tuple[np.ndarray, np.ndarray]:
        return self.network.compute_rises()

    def find_rise(self, time_s: np.ndarray) -> np.ndarray:
        """Return the temperatures of the bodies above their begin, (n, 7)."""
        at, rise = self.rises
        now = self.begin_s + time_s
        return np.stack([np.interp(now, at, one) for one in rise.T], axis=1)

    def added_error_motions(
        self, motion: Motion, time_s: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Return growth of the scales, bend and twist of the column."""
        position = motion.timeline.positions(time_s)
        return self.bend(motion.machine, position, time_s)

    def bend(
        self, machine: MachineFile, position: np.ndarray, time_s: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Return what joints do beyond their motions, at positions and times."""
        rise = self.find_rise(time_s)
        total: dict[str, np.ndarray] = {}
        for body, axis in enumerate(machine.linear_axes):
            added = np.zeros((len(position), 6))
            gone = position[:, body] - axis.zero_mm
            added[:, body] = self.per_k[body] * rise[:, body] * gone
            if axis.name == "Z":
                curve = self.per_k[3] * (rise[:, _FRONT] - rise[:, _BACK])
                curve /= self.depth_mm
                added[:, 4] += curve * gone
                added[:, 0] += 0.5 * curve * gone**2
                added[:, 5] += self.twist * curve * gone
            if axis.name == "X":
                curve = self.per_k[3] * 0.3 * (rise[:, _X] - rise[:, _BED])
                curve /= self.depth_mm
                added[:, 4] += curve * gone
                added[:, 2] -= 0.5 * curve * gone**2
            total[axis.name] = added
        return total

    def common_shift_mm(self, motion: Motion, time_s: np.ndarray) -> np.ndarray:
        del motion
        shift = np.zeros((len(time_s), 3))
        shift[:, 2] = -1e-3 * 2.0 * self.find_rise(time_s)[:, _SPINDLE]
        return shift

    def warming_degc(self, axis: str, time_s: np.ndarray) -> np.ndarray:
        """Return what the sensor beside a scale shows: some of the bed as well."""
        rise = self.find_rise(time_s)
        return 0.8 * rise[:, "XYZ".index(axis)] + 0.2 * rise[:, _BED]


@dataclass(frozen=True)
class WarmMachine:
    """The truth of a machine at one moment, as a truth machine answers."""

    truth: TruthMachine
    warming: Warming
    time_s: float

    def deviation_mm(self, q: np.ndarray) -> np.ndarray:
        """Return actual minus nominal tool point, (n, 3)."""
        machine = self.truth.machine
        carry = self.warming.bend(machine, q, np.full(len(q), self.time_s))
        reflector = machine.reflector("")
        actual = self.truth.point_mm(q, reflector, carry=carry)
        return actual - self.truth.nominal_point_mm(q, reflector)


@dataclass(frozen=True)
class WarmingWorld:
    """Short Runs of one machine; time_s : the middle of each, since the first began."""

    recordings: tuple[Recording, ...]
    time_s: np.ndarray
    truth: TruthMachine
    warming: Warming

    def at(self, time_s: float) -> WarmMachine:
        return WarmMachine(self.truth, self.warming, time_s)


def draw_warming_world(seed: int) -> WarmingWorld:
    """Draw a small machine, its heat, and six to ten Runs in two to eight hours."""
    rng = np.random.default_rng([seed, 31])
    travel = tuple(np.round(rng.uniform(250.0, 600.0, 3), 0))
    tool = (*np.round(rng.uniform(-60, 60, 2), 1), -round(rng.uniform(80, 200), 1))
    content = machine_content(CHAINS[rng.integers(len(CHAINS))], travel, tool)
    content["tracker"]["rate_hz"] = _RATE_HZ
    machine = parse_machine(content)
    warming = Warming.draw(rng, Occasion.usual(machine, 1.0))
    count, span_h = int(rng.integers(6, 11)), float(rng.uniform(2.0, 8.0))
    # Closer at first, as the machine warms then.
    share = (np.arange(count) / (count - 1)) ** rng.uniform(1.0, 1.7)
    begins = HOUR_S * span_h * share
    program = plan_program(content, _FEED_MM_MIN, _LINES)
    recordings = tuple(
        synthetic.record(
            content,
            program,
            100 * seed + k,
            "otf",
            synthetic.Setting(
                machine_seed=seed,
                air=random_air(seed),
                hidden=(_begin(warming, float(begin)),),
            ),
        )
        for k, begin in enumerate(begins)
    )
    middle = np.array([0.5 * one.timeline.end_s for one in recordings])
    truth = random_machine(machine, seed)
    return WarmingWorld(recordings, begins + middle, truth, warming)


def _begin(warming: Warming, begin_s: float) -> Warming:
    return Warming(
        warming.network, warming.per_k, warming.depth_mm, warming.twist, begin_s
    )


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
        self.values.setdefault(key, []).append(value)

    def mean(self, *key: str) -> float:
        return float(np.mean(self.values[key]))

    def rms(self, *key: str) -> float:
        return float(np.sqrt(np.mean(np.square(self.values[key]))))

    def get(self, *key: str) -> np.ndarray:
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
