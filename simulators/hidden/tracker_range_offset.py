"""A wrong home distance, or the constant of another reflector."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from truepath.simulators.hidden.effect import HiddenEffect, Occasion


@dataclass(frozen=True, slots=True)
class TrackerRangeOffset(HiddenEffect):
    """Every range is read too long by the same amount."""

    name = "tracker-range-offset"
    offset_um: float

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Draw a sign.

        Most of it shifts the tracker: eight times the size is needed for its bend to
        move the point by the size.
        """
        return cls(8.0 * occasion.size_um * float(rng.choice([-1.0, 1.0])))

    def misread(self, polar: np.ndarray) -> np.ndarray:
        """Return the offset in every range."""
        error = np.zeros_like(polar)
        error[:, 0] = 1e-3 * self.offset_um
        return error
