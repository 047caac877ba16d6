"""A screw worn where it works most: play there, and none elsewhere."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from truepath.simulators.hidden.effect import HiddenEffect, Occasion, error_motion
from truepath.simulators.hidden.motion import Motion

_TURNOVER_MM = 0.2


@dataclass(frozen=True, slots=True)
class WornScrew(HiddenEffect):
    """Lost motion of width exp(−½ ((u − middle) / spread)²), u the share of travel."""

    name = "worn-screw"
    in_catalogue = False
    unstated = ("middle", "spread")
    axis: str
    width_um: float
    middle: float
    spread: float

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Draw an axis and where it is worn."""
        middle, spread = rng.uniform(0.3, 0.7), rng.uniform(0.08, 0.14)
        width_um = 6.0 * occasion.size_um
        return cls(occasion.axis(rng), width_um, float(middle), float(spread))

    def carry(self, motion: Motion, time_s: np.ndarray) -> dict[str, np.ndarray]:
        """Return how far the nut lags: half the width there, by the side it is on."""
        half_mm = 0.5 * _TURNOVER_MM
        follows = motion.play_mm(self.axis, half_mm, time_s)
        side = (motion.position_mm(self.axis, time_s) - follows) / half_mm
        off = (motion.share(self.axis, time_s) - self.middle) / self.spread
        half = 0.5e-3 * self.width_um * np.exp(-0.5 * off**2)
        return error_motion(f"E{2 * self.axis}", -half * side)
