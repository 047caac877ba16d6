"""A slide that floats up on its oil: the faster, the higher."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from truepath.simulators.hidden.effect import HiddenEffect, Occasion, error_motion
from truepath.simulators.hidden.motion import Motion


@dataclass(frozen=True, slots=True)
class FloatingSlide(HiddenEffect):
    """lift v² / (v² + usual²) across an axis, whichever way it goes at v."""

    name = "floating-slide"
    in_catalogue = False
    unstated = ("usual_mm_s",)
    axis: str
    direction: str
    lift_um: float
    usual_mm_s: float

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Draw an axis and a direction across it."""
        axis = occasion.axis(rng)
        direction = str(rng.choice([d for d in "XYZ" if d != axis]))
        return cls(axis, direction, 3.0 * occasion.size_um, 0.5 * occasion.feed_mm_s)

    def carry(self, motion: Motion, time_s: np.ndarray) -> dict[str, np.ndarray]:
        """Return how far the oil film carries."""
        square = motion.derivatives(self.axis, time_s)[0] ** 2
        lift = square / (square + self.usual_mm_s**2)
        return error_motion(f"E{self.direction}{self.axis}", 1e-3 * self.lift_um * lift)
