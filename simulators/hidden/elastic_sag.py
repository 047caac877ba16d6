"""A guide that bends under the carriage that travels on it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from truepath.simulators.hidden.effect import HiddenEffect, Occasion, error_motion
from truepath.simulators.hidden.motion import Motion


@dataclass(frozen=True, slots=True)
class ElasticSag(HiddenEffect):
    """−amplitude 4u(1 − u) v: most in mid guide, in proportion to what it bears.

    u : share of the travel along `axis`, the guide; v : along `by`, whose carriage
        brings the load from one guide to the other
    """

    name = "elastic-sag"
    axis: str
    by: str
    direction: str
    amplitude_um: float

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Draw guide, carriage and direction.

        The mean over v is straightness, the mean over u a tilt, so that four times the
        size is needed to move the point by the size about what is rigid.
        """
        axis = occasion.axis(rng)
        by = str(rng.choice([n for n in "XYZ" if n != axis]))
        amplitude = 4.0 * occasion.size_um * float(rng.choice([-1.0, 1.0]))
        return cls(axis, by, str(rng.choice(list("XYZ"))), amplitude)

    def carry(self, motion: Motion, time_s: np.ndarray) -> dict[str, np.ndarray]:
        """Return the guide's deflection under the carriage."""
        u, v = (motion.share(name, time_s) for name in (self.axis, self.by))
        deflection = -1e-3 * self.amplitude_um * 4.0 * u * (1.0 - u) * v
        return error_motion(f"E{self.direction}{self.axis}", deflection)
