"""A tripod of the tracker that gives way and leans, fast at first, then slower."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from truepath.simulators.hidden.effect import HiddenEffect, Occasion
from truepath.simulators.hidden.motion import Motion


@dataclass(frozen=True, slots=True)
class SettlingStand(HiddenEffect):
    """All points turn about the foot of the stand, by tilt (1 − exp(−t/τ)).

    tilt_urad : about X and Y, in the end
    """

    name = "settling-stand"
    in_catalogue = False
    tilt_urad: tuple[float, float]
    tau_s: float

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Draw which way it leans, and how soon it rests."""
        angle = float(rng.uniform(0.0, 2.0 * np.pi))
        tilt = 4.0 * 1e3 * occasion.size_um / occasion.distance_mm
        tau_s = float(rng.uniform(0.15, 0.4) * occasion.duration_s)
        return cls((tilt * float(np.cos(angle)), tilt * float(np.sin(angle))), tau_s)

    def shift_mm(self, motion: Motion, time_s: np.ndarray) -> np.ndarray:
        """Return how the points turn about a foot below the travel's low corner."""
        place = [motion.position_mm(name, time_s) for name in "XYZ"]
        arm = np.stack(place, axis=1) - motion.machine.low_mm
        arm[:, 2] += 1000.0
        leans = -np.expm1(-np.maximum(time_s, 0.0) / self.tau_s)
        turn = 1e-6 * np.outer(leans, [*self.tilt_urad, 0.0])
        return np.cross(turn, arm)
