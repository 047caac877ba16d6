"""Lost motion: the nut has play, the table follows when the screw has crossed it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from truepath.simulators.hidden.effect import HiddenEffect, Occasion, error_motion
from truepath.simulators.hidden.motion import Motion


@dataclass(frozen=True, slots=True)
class Backlash(HiddenEffect):
    """Play of an axis in its own direction; positive widths lose motion."""

    name = "backlash"
    axis: str
    width_um: float

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Draw an axis; half of the width to either side."""
        return cls(occasion.axis(rng), 2.0 * occasion.size_um)

    def carry(self, motion: Motion, time_s: np.ndarray) -> dict[str, np.ndarray]:
        """Return how far the table is from where the screw is."""
        table = motion.play_mm(self.axis, 0.5e-3 * self.width_um, time_s)
        off = table - motion.position_mm(self.axis, time_s)
        return error_motion(f"E{self.axis}{self.axis}", off)
