"""An encoder circle of the tracker that sits off its axis."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from truepath.simulators.hidden.effect import HiddenEffect, Occasion

_CIRCLES = {"azimuth": 1, "elevation": 2}


@dataclass(frozen=True, slots=True)
class TrackerEccentricity(HiddenEffect):
    """The angle read is wrong by amplitude sin(angle + phase)."""

    name = "tracker-eccentricity"
    circle: str
    amplitude_urad: float
    phase_rad: float

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Draw a circle and a phase.

        Offset and slope of the wave over the angles in use turn the tracker: ten times
        the size is needed for its bend alone to move the point by the size.
        """
        amplitude = 10.0 * 1e3 * occasion.size_um / occasion.distance_mm
        circle = str(rng.choice(list(_CIRCLES)))
        return cls(circle, amplitude, float(rng.uniform(0.0, 2.0 * np.pi)))

    def misread(self, polar: np.ndarray) -> np.ndarray:
        """Return the error of the reading head."""
        column = _CIRCLES[self.circle]
        error = np.zeros_like(polar)
        error[:, column] = (
            1e-6 * self.amplitude_urad * np.sin(polar[:, column] + self.phase_rad)
        )
        return error
