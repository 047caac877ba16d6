"""A recording and the truth behind it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from truepath_simulators.hidden.effect import HiddenEffect
from truepath_simulators.machine.tracker_head import TrackerClock, TrackerPose
from truepath_simulators.machine.truth_machine import TruthMachine
from truepath_simulators.motion.program import Program
from truepath_simulators.timeline import Timeline


@dataclass(frozen=True, slots=True)
class Temperatures:
    """Readings of sensors on the tracker's clock.

    names : of the axes whose scales have one; time_s (n,); celsius (n, sensors)
    """

    names: tuple[str, ...]
    time_s: np.ndarray
    celsius: np.ndarray


@dataclass(frozen=True, slots=True)
class Recording:
    """A recording and its truth.

    time_s (n,), position_mm (n, 3), status (n,) : in the tracker's frame and clock
    commanded_mm (n, 3) : nominal axis positions at each sample
    row (n,) : towards which the machine moved, or at which it dwelt, at each sample
    hidden : effects outside of a rigid-body model; clock : of the tracker
    temperatures : None where the machine has no sensors
    """

    content: Mapping[str, Any]
    mode: str
    program: Program
    truth: TruthMachine
    pose: TrackerPose
    time_s: np.ndarray
    position_mm: np.ndarray
    status: np.ndarray
    commanded_mm: np.ndarray
    row: np.ndarray
    timeline: Timeline
    clock: TrackerClock
    hidden: tuple[HiddenEffect, ...] = ()
    temperatures: Temperatures | None = None

    def __len__(self) -> int:
        return len(self.time_s)

    def hidden_truth(self) -> list[dict[str, Any]]:
        """Hidden effects in the form of `discovery.json`."""
        return [effect.truth(self.clock) for effect in self.hidden]
