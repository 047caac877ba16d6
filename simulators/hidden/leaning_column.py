"""A column that leans as another carriage moves: a rotation of two axes at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from truepath.simulators.hidden.effect import HiddenEffect, Occasion, error_motion
from truepath.simulators.hidden.motion import Motion

_ARM_M = 0.25


@dataclass(frozen=True, slots=True)
class LeaningColumn(HiddenEffect):
    """An angle of one axis, amplitude sin(π u) cos(π v), v of the other axis.

    u, v : shares of both travels
    """

    name = "leaning-column"
    in_catalogue = False
    motion: str
    by: str
    amplitude_urad: float

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Draw two axes and an angle; it acts over a quarter of a metre."""
        first, second, _ = rng.permutation(list("XYZ"))
        amplitude = 2.0 * occasion.size_um / _ARM_M
        return cls(f"E{rng.choice(list('ABC'))}{first}", str(second), amplitude)

    def carry(self, motion: Motion, time_s: np.ndarray) -> dict[str, np.ndarray]:
        """Return the lean where both axes are."""
        u, v = (motion.share(name, time_s) for name in (self.motion[2], self.by))
        lean = np.sin(np.pi * u) * np.cos(np.pi * v)
        return error_motion(self.motion, 1e-6 * self.amplitude_urad * lean)
