"""A pump, a fan or a drive that shakes table or tracker."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from truepath.simulators.hidden.effect import HiddenEffect, Occasion, along
from truepath.simulators.hidden.motion import Motion
from truepath.simulators.tracker_head import TrackerClock

_SLOWEST_HZ, _FASTEST_HZ = 1.0, 80.0


@dataclass(frozen=True, slots=True)
class Vibration(HiddenEffect):
    """amplitude sin(2π f t + phase) in one direction."""

    name = "vibration"
    direction: str
    frequency_hz: float
    amplitude_um: float
    phase_rad: float = 0.0

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Draw a direction and a frequency, evenly in its logarithm."""
        low, high = np.log(_SLOWEST_HZ), np.log(_FASTEST_HZ)
        return cls(
            str(rng.choice(list("XYZ"))),
            float(np.exp(rng.uniform(low, high))),
            occasion.size_um,
            float(rng.uniform(0.0, 2.0 * np.pi)),
        )

    def parameters(self, clock: TrackerClock) -> dict[str, float]:
        """Return frequency, on the tracker's clock, and amplitude."""
        return {
            "frequency_hz": self.frequency_hz / (1.0 + clock.drift),
            "amplitude_um": self.amplitude_um,
        }

    def shift_mm(self, motion: Motion, time_s: np.ndarray) -> np.ndarray:
        """Return the wave."""
        del motion
        angle = 2.0 * np.pi * self.frequency_hz * time_s + self.phase_rad
        return along(self.direction, 1e-3 * self.amplitude_um * np.sin(angle))
