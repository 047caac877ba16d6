"""Coolant or air conditioning that switches on and off: slow, and in no catalogue."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from truepath.simulators.hidden.effect import HiddenEffect, Occasion, along
from truepath.simulators.hidden.motion import Motion
from truepath.simulators.tracker_head import TrackerClock


@dataclass(frozen=True, slots=True)
class CoolantCycle(HiddenEffect):
    """A steady cycle in time, slower than a vibration, in one direction.

    sharpness : 0 for a sine; above it warming and cooling have a corner
    """

    name = "coolant-cycle"
    in_catalogue = False
    direction: str
    period_s: float
    amplitude_um: float
    phase_rad: float = 0.0
    sharpness: float = 0.0

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Draw a period that is seen at least four times."""
        longest = min(60.0, occasion.duration_s / 4.0)
        return cls(
            str(rng.choice(list("XYZ"))),
            float(rng.uniform(8.0, longest)),
            occasion.size_um,
            float(rng.uniform(0.0, 2.0 * np.pi)),
            float(rng.uniform(0.0, 0.3)),
        )

    def parameters(self, clock: TrackerClock) -> dict[str, float]:
        """Return period and amplitude."""
        period_s = self.period_s * (1.0 + clock.drift)
        return {"period_s": period_s, "amplitude_um": self.amplitude_um}

    def shift_mm(self, motion: Motion, time_s: np.ndarray) -> np.ndarray:
        """Return the cycle."""
        del motion
        angle = 2.0 * np.pi / self.period_s * time_s + self.phase_rad
        wave = np.sin(angle + self.sharpness * np.sin(angle))
        return along(self.direction, 1e-3 * self.amplitude_um * wave)
