"""An axis that sticks when it turns back, and recovers within some millimetres."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from truepath.simulators.hidden.effect import HiddenEffect, Occasion, error_motion
from truepath.simulators.hidden.motion import Motion


@dataclass(frozen=True, slots=True)
class ReversalSpike(HiddenEffect):
    """An excursion that fades with the travel since the reversal.

    It has the sign of the direction that the axis then goes in.
    """

    name = "reversal-spike"
    axis: str
    direction: str
    amplitude_um: float
    decay_mm: float

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Draw an axis, a direction and how soon it fades."""
        return cls(
            occasion.axis(rng),
            str(rng.choice(list("XYZ"))),
            occasion.size_um * float(rng.choice([-1.0, 1.0])),
            float(rng.uniform(5.0, 30.0)),
        )

    def carry(self, motion: Motion, time_s: np.ndarray) -> dict[str, np.ndarray]:
        """Return what is left of the excursion."""
        travel, sign = motion.since_reversal_mm(self.axis, time_s)
        left = 1e-3 * self.amplitude_um * sign * np.exp(-travel / self.decay_mm)
        return error_motion(f"E{self.direction}{self.axis}", left)
