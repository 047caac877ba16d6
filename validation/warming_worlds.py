"""Machines that warm: a network of heat, drawn by seed, measured by short Runs.

Seven bodies exchange heat with each other and with the air, which has a day of its own:
the drives and scales of three axes, spindle, front and back of the column, bed. Scales
grow, the column bends as its front is warmer than its back, and twists a little; the
spindle grows, which shifts the volume as a whole. Nothing of it settles with one time
constant, and no temperature is that of what grows.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from recordings import CHAINS, machine_content, plan_program, random_air

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
        """Times and temperatures of the bodies."""
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
        """Return the growth of the spindle."""
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
        """Return the truth at a moment."""
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
