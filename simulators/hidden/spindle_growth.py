"""A spindle or a column that warms and carries the tool along."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from truepath.simulators.hidden.effect import HiddenEffect, Occasion, along
from truepath.simulators.hidden.motion import Motion


@dataclass(frozen=True, slots=True)
class SpindleGrowth(HiddenEffect):
    """A first-order rise along the spindle from the begin of the recording."""

    name = "spindle-growth"
    growth_um: float
    tau_s: float

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Draw how fast; from begin to end the tool moves by twice the size."""
        tau_s = float(rng.uniform(0.1, 0.8) * occasion.duration_s)
        reached = 1.0 - np.exp(-occasion.duration_s / tau_s)
        sign = float(rng.choice([-1.0, 1.0]))
        return cls(float(2.0 * sign * occasion.size_um / reached), tau_s)

    def shift_mm(self, motion: Motion, time_s: np.ndarray) -> np.ndarray:
        """Return the tool's way along Z; no head is thought to swivel."""
        del motion
        rise = -np.expm1(-np.maximum(time_s, 0.0) / self.tau_s)
        return along("Z", 1e-3 * self.growth_um * rise)
