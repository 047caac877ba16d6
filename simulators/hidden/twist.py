"""A frame that twists with two axes at once, in no shape that a catalogue has."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from truepath.simulators.hidden.effect import HiddenEffect, Occasion, error_motion
from truepath.simulators.hidden.motion import Motion


@dataclass(frozen=True, slots=True)
class Twist(HiddenEffect):
    """amplitude sin(π waves u) sin(π waves v), u and v the shares of the travels."""

    name = "twist"
    in_catalogue = False
    first: str
    second: str
    direction: str
    amplitude_um: float
    waves: tuple[float, float] = (2.0, 2.0)

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Draw two axes and how often each bulges: at least once up and once down."""
        first, second, _ = rng.permutation(list("XYZ"))
        waves = (float(rng.uniform(1.8, 2.2)), float(rng.uniform(1.8, 2.2)))
        direction = str(rng.choice(list("XYZ")))
        return cls(str(first), str(second), direction, 2.0 * occasion.size_um, waves)

    @property
    def keys(self) -> dict[str, str]:
        """Both axes and the direction."""
        return {"plane": self.first + self.second, "direction": self.direction}

    def carry(self, motion: Motion, time_s: np.ndarray) -> dict[str, np.ndarray]:
        """Return the bulge where both axes are."""
        bulge = np.ones(len(time_s))
        for name, waves in zip((self.first, self.second), self.waves, strict=True):
            bulge *= np.sin(np.pi * waves * motion.share(name, time_s))
        return error_motion(
            f"E{self.direction}{self.first}", 1e-3 * self.amplitude_um * bulge
        )
