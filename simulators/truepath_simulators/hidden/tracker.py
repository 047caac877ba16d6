"""Errors of the tracker's readings, and of the air along its beam."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from truepath_simulators.hidden.effect import HiddenEffect, Occasion

# An encoder circle of the tracker that sits off its axis.
_CIRCLES = {"azimuth": 1, "elevation": 2}


@dataclass(frozen=True, slots=True)
class TrackerEccentricity(HiddenEffect):
    """The angle has an error of amplitude sin(angle + phase)."""

    name = "tracker-eccentricity"
    circle: str
    amplitude_urad: float
    phase_rad: float

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Random circle and phase.

        Offset and slope of the wave over the angles in use turn the tracker: ten times
        the size is needed for its curvature alone to move the point by the size.
        """
        amplitude = 10.0 * 1e3 * occasion.size_um / occasion.distance_mm
        circle = str(rng.choice(list(_CIRCLES)))
        return cls(circle, amplitude, float(rng.uniform(0.0, 2.0 * np.pi)))

    def reading_error(self, polar: np.ndarray) -> np.ndarray:
        """Error of the reading head."""
        column = _CIRCLES[self.circle]
        error = np.zeros_like(polar)
        error[:, column] = (
            1e-6 * self.amplitude_urad * np.sin(polar[:, column] + self.phase_rad)
        )
        return error


# A wrong home distance, or the constant of another reflector.
@dataclass(frozen=True, slots=True)
class TrackerRangeOffset(HiddenEffect):
    """Every range is read too long by the same amount."""

    name = "tracker-range-offset"
    offset_um: float

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Random sign.

        Most of it shifts the tracker: eight times the size is needed for its curvature
        to move the point by the size.
        """
        return cls(8.0 * occasion.size_um * float(rng.choice([-1.0, 1.0])))

    def reading_error(self, polar: np.ndarray) -> np.ndarray:
        """The offset in every range."""
        error = np.zeros_like(polar)
        error[:, 0] = 1e-3 * self.offset_um
        return error


# A distance meter with stray light or crosstalk of its own modulation.
@dataclass(frozen=True, slots=True)
class RangeCycle(HiddenEffect):
    """The phase of the light is that of its sum with a steady, small phasor.

    period_mm : of the range, half the wavelength of the modulation
    amplitude_um : as that of the range, for a phasor small against the signal
    """

    name = "range-cycle"
    period_mm: float
    amplitude_um: float
    phase_rad: float = 0.0

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Random phase and period, uniform in its logarithm."""
        period_mm = float(np.exp(rng.uniform(*np.log([5.0, 300.0]))))
        return cls(period_mm, occasion.size_um, float(rng.uniform(0.0, 2.0 * np.pi)))

    def reading_error(self, polar: np.ndarray) -> np.ndarray:
        """Phase of the sum less that of the signal alone, as a range."""
        mm_per_rad = self.period_mm / (2.0 * np.pi)
        stray = 1e-3 * self.amplitude_um / mm_per_rad
        signal = np.exp(1j * polar[:, 0] / mm_per_rad)
        mixed = signal + stray * np.exp(-1j * self.phase_rad)
        error = np.zeros_like(polar)
        error[:, 0] = -mm_per_rad * np.angle(mixed / signal)
        return error


# A plume of warm air next to the machine: distances through it are too short.
@dataclass(frozen=True, slots=True)
class WarmPlume(HiddenEffect):
    """The error of the range is amplitude exp(−½ ((azimuth − middle) / width)²)."""

    name = "warm-plume"
    in_catalogue = False
    amplitude_um: float
    middle_rad: float
    width_rad: float

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Random azimuth of the plume."""
        return cls(
            -3.0 * occasion.size_um,
            float(rng.uniform(-np.pi, np.pi)),
            float(rng.uniform(0.08, 0.2)),
        )

    def reading_error(self, polar: np.ndarray) -> np.ndarray:
        """Error of the range of beams through it."""
        off = np.angle(np.exp(1j * (polar[:, 1] - self.middle_rad))) / self.width_rad
        error = np.zeros_like(polar)
        error[:, 0] = 1e-3 * self.amplitude_um * np.exp(-0.5 * off**2)
        return error
