"""A plume of warm air beside the machine: distances through it read too short."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from truepath.simulators.hidden.effect import HiddenEffect, Occasion


@dataclass(frozen=True, slots=True)
class WarmPlume(HiddenEffect):
    """The range errs by amplitude exp(−½ ((azimuth − middle) / width)²)."""

    name = "warm-plume"
    in_catalogue = False
    amplitude_um: float
    middle_rad: float
    width_rad: float

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Draw where it rises, over directions that a beam may have."""
        return cls(
            -3.0 * occasion.size_um,
            float(rng.uniform(-np.pi, np.pi)),
            float(rng.uniform(0.08, 0.2)),
        )

    def misread(self, polar: np.ndarray) -> np.ndarray:
        """Return what beams through it lack."""
        off = np.angle(np.exp(1j * (polar[:, 1] - self.middle_rad))) / self.width_rad
        error = np.zeros_like(polar)
        error[:, 0] = 1e-3 * self.amplitude_um * np.exp(-0.5 * off**2)
        return error
