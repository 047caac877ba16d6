"""Tracker, stand, table and nest that move; errors of the readings and of the air."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from truepath_simulators.hidden.effect import HiddenEffect, Occasion
from truepath_simulators.hidden.motion import Motion
from truepath_simulators.machine.tracker_head import TrackerClock


# An unintended shift of the tracker, its stand or the target's nest.
@dataclass(frozen=True, slots=True)
class SetupStep(HiddenEffect):
    """All points are shifted from one moment on.

    time_s : of the machine's clock
    """

    name = "setup-step"
    time_s: float
    step_um: tuple[float, float, float]

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Random moment in the middle two thirds; the step is twice the size."""
        direction = rng.normal(size=3)
        direction /= np.linalg.norm(direction)
        x, y, z = 2.0 * occasion.size_um * direction
        moment_s = float(rng.uniform(1.0 / 6.0, 5.0 / 6.0) * occasion.duration_s)
        return cls(moment_s, (float(x), float(y), float(z)))

    def parameters(self, clock: TrackerClock) -> dict[str, float | tuple[float, ...]]:
        """The moment on the tracker's clock, and the step."""
        return {"t_s": clock.device_s(self.time_s), "step_um": self.step_um}

    def common_shift_mm(self, motion: Motion, time_s: np.ndarray) -> np.ndarray:
        del motion
        return 1e-3 * np.outer(time_s >= self.time_s, self.step_um)


# A tripod of the tracker that gives way and leans, fast at first, then slower.
@dataclass(frozen=True, slots=True)
class SettlingStand(HiddenEffect):
    """All points turn about the foot of the stand, by tilt (1 − exp(−t/τ)).

    tilt_urad : about X and Y, in the end
    """

    name = "settling-stand"
    in_catalogue = False
    tilt_urad: tuple[float, float]
    tau_s: float

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Random direction of the lean, and time constant."""
        angle = float(rng.uniform(0.0, 2.0 * np.pi))
        tilt = 4.0 * 1e3 * occasion.size_um / occasion.distance_mm
        tau_s = float(rng.uniform(0.15, 0.4) * occasion.duration_s)
        return cls((tilt * float(np.cos(angle)), tilt * float(np.sin(angle))), tau_s)

    def common_shift_mm(self, motion: Motion, time_s: np.ndarray) -> np.ndarray:
        """Turn of the points about a foot below the travel's low corner."""
        place = [motion.position_mm(name, time_s) for name in "XYZ"]
        arm = np.stack(place, axis=1) - motion.machine.low_mm
        arm[:, 2] += 1000.0
        leans = -np.expm1(-np.maximum(time_s, 0.0) / self.tau_s)
        turn = 1e-6 * np.outer(leans, [*self.tilt_urad, 0.0])
        return np.cross(turn, arm)


# A tracker stand or a table that creeps.
@dataclass(frozen=True, slots=True)
class TableDrift(HiddenEffect):
    """All points shift at a steady rate."""

    name = "table-drift"
    rate_um_per_s: tuple[float, float, float]

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Random direction; from begin to end it creeps twice the size."""
        direction = rng.normal(size=3)
        direction /= np.linalg.norm(direction)
        x, y, z = 2.0 * occasion.size_um / occasion.duration_s * direction
        return cls((float(x), float(y), float(z)))

    def common_shift_mm(self, motion: Motion, time_s: np.ndarray) -> np.ndarray:
        del motion
        return 1e-3 * np.outer(time_s, self.rate_um_per_s)


# A target that is loose in its nest: it moves at each start from rest.
_SEATS = 1000


@dataclass(frozen=True, slots=True)
class LooseNest(HiddenEffect):
    """A different random shift on every line: spread_um along each axis."""

    name = "loose-nest"
    in_catalogue = False
    unstated = ("chance",)
    spread_um: float
    chance: int

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        return cls(0.7 * occasion.size_um, int(rng.integers(1 << 30)))

    def common_shift_mm(self, motion: Motion, time_s: np.ndarray) -> np.ndarray:
        seats = np.random.default_rng(self.chance).normal(size=(_SEATS, 3))
        row = motion.timeline.rows(time_s) % _SEATS
        return 1e-3 * self.spread_um * seats[row]


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
        return cls(
            -3.0 * occasion.size_um,
            float(rng.uniform(-np.pi, np.pi)),
            float(rng.uniform(0.08, 0.2)),
        )

    def reading_error(self, polar: np.ndarray) -> np.ndarray:
        off = np.angle(np.exp(1j * (polar[:, 1] - self.middle_rad))) / self.width_rad
        error = np.zeros_like(polar)
        error[:, 0] = 1e-3 * self.amplitude_um * np.exp(-0.5 * off**2)
        return error
