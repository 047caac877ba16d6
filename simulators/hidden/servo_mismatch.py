"""A position loop that follows its command later than those of the other axes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from truepath.simulators.hidden.effect import HiddenEffect, Occasion, error_motion
from truepath.simulators.hidden.motion import Motion


@dataclass(frozen=True, slots=True)
class ServoMismatch(HiddenEffect):
    """A first-order lag of one axis, ramps included; positive lags are late."""

    name = "servo-mismatch"
    axis: str
    lag_ms: float

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Draw an axis; at the usual feed it lags, or leads, by the size."""
        lag_ms = occasion.size_um / occasion.feed_mm_s * float(rng.choice([-1.0, 1.0]))
        return cls(occasion.axis(rng), lag_ms)

    def carry(self, motion: Motion, time_s: np.ndarray) -> dict[str, np.ndarray]:
        """Return the following error, r − c of lag r' = c − r.

        For a command c of cubic pieces r − c = −lag c' + lag² c'' − lag³ c'''; what a
        piece's begin excites is a jump of lag³ c''', for 0.1 ms less than 0.1 nm.
        """
        lag_s = 1e-3 * self.lag_ms
        velocity, acceleration, jerk = motion.derivatives(self.axis, time_s)
        behind = lag_s * (velocity - lag_s * (acceleration - lag_s * jerk))
        return error_motion(f"E{self.axis}{self.axis}", -behind)
