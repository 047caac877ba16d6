"""A ball screw that wobbles: its error repeats with every turn."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from truepath.simulators.hidden.effect import HiddenEffect, Occasion, error_motion
from truepath.simulators.hidden.motion import Motion

_LEADS_MM = (5.0, 6.0, 8.0, 10.0, 12.0, 16.0, 20.0, 25.0, 32.0, 40.0)


@dataclass(frozen=True, slots=True)
class ScrewCyclic(HiddenEffect):
    """amplitude sin(angle + phase) of the screw's angle, with a little of twice it."""

    name = "screw-cyclic"
    axis: str
    lead_mm: float
    amplitude_um: float
    phase_rad: float
    second_share: float = 0.0

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Draw one of the usual leads, and a second harmonic of at most a tenth."""
        return cls(
            occasion.axis(rng),
            float(rng.choice(_LEADS_MM)),
            occasion.size_um,
            float(rng.uniform(0.0, 2.0 * np.pi)),
            float(rng.uniform(0.0, 0.1)),
        )

    def carry(self, motion: Motion, time_s: np.ndarray) -> dict[str, np.ndarray]:
        """Return the nut's error by the angle of the screw."""
        turned = motion.position_mm(self.axis, time_s) / self.lead_mm
        angle = 2.0 * np.pi * turned + self.phase_rad
        wave = np.sin(angle) + self.second_share * np.sin(2.0 * angle)
        return error_motion(f"E{self.axis}{self.axis}", 1e-3 * self.amplitude_um * wave)
