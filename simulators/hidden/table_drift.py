"""A tracker stand or a table that creeps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from truepath.simulators.hidden.effect import HiddenEffect, Occasion
from truepath.simulators.hidden.motion import Motion


@dataclass(frozen=True, slots=True)
class TableDrift(HiddenEffect):
    """All points shift at a steady rate."""

    name = "table-drift"
    rate_um_per_s: tuple[float, float, float]

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Draw a direction; from begin to end it creeps twice the size."""
        direction = rng.normal(size=3)
        direction /= np.linalg.norm(direction)
        x, y, z = 2.0 * occasion.size_um / occasion.duration_s * direction
        return cls((float(x), float(y), float(z)))

    def shift_mm(self, motion: Motion, time_s: np.ndarray) -> np.ndarray:
        """Return the rate times the time."""
        del motion
        return 1e-3 * np.outer(time_s, self.rate_um_per_s)
