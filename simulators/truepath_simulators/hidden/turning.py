"""Drives and weights of rotary axes: play, cyclic errors of gears, sag by swivels.

If the axis carries the workpiece, a lag of its angle turns the tool the other way
relative to the workpiece.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from truepath_simulators.hidden.effect import HiddenEffect, Occasion, error_motion
from truepath_simulators.hidden.motion import Motion

_REACH_MM = 120.0  # typical, from the axis to a target
_PERIODS_DEG = (4.0, 5.0, 6.0, 9.0, 12.0)


def _turn(motion: Motion, axis: str, off_rad: np.ndarray) -> dict[str, np.ndarray]:
    """Reversed where the axis carries the workpiece."""
    carries_workpiece = axis in motion.machine.workpiece_side
    return error_motion(f"E{axis}{axis}", -off_rad if carries_workpiece else off_rad)


def _choose_rotary(rng: np.random.Generator, occasion: Occasion) -> str:
    return str(rng.choice([axis.name for axis in occasion.machine.rotary_axes]))


@dataclass(frozen=True, slots=True)
class TurningBacklash(HiddenEffect):
    """Play of a rotary axis."""

    name = "backlash"
    axis: str
    width_urad: float

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Random axis; half of the width to either side."""
        width = 2e3 * occasion.size_um / _REACH_MM
        return cls(_choose_rotary(rng, occasion), width)

    def added_error_motions(
        self, motion: Motion, time_s: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Angle of the table or head relative to its drive."""
        half_deg = float(np.degrees(0.5e-6 * self.width_urad))
        follows = motion.play_mm(self.axis, half_deg, time_s)
        off_deg = follows - motion.position_mm(self.axis, time_s)
        return _turn(motion, self.axis, np.radians(off_deg))


@dataclass(frozen=True, slots=True)
class GearCyclic(HiddenEffect):
    """amplitude sin(360° angle / period + phase) of a worm or ring scale."""

    name = "gear-cyclic"
    axis: str
    period_deg: float
    amplitude_urad: float
    phase_rad: float

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Random axis, and one of the typical periods."""
        return cls(
            _choose_rotary(rng, occasion),
            float(rng.choice(_PERIODS_DEG)),
            1e3 * occasion.size_um / _REACH_MM,
            float(rng.uniform(0.0, 2.0 * np.pi)),
        )

    def added_error_motions(
        self, motion: Motion, time_s: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Error of the angle."""
        turned = motion.position_mm(self.axis, time_s) / self.period_deg
        wave = np.sin(2.0 * np.pi * turned + self.phase_rad)
        return _turn(motion, self.axis, 1e-6 * self.amplitude_urad * wave)


@dataclass(frozen=True, slots=True)
class SwivelSag(HiddenEffect):
    """−amplitude 4u(1 − u) sin(angle + phase): a guide under a weight that swivels."""

    name = "swivel-sag"
    axis: str
    by: str
    direction: str
    amplitude_um: float
    phase_rad: float

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Random guide, swivel and direction; partly straightness and location."""
        return cls(
            occasion.axis(rng),
            _choose_rotary(rng, occasion),
            str(rng.choice(list("XYZ"))),
            2.0 * occasion.size_um,
            float(rng.uniform(0.0, 2.0 * np.pi)),
        )

    def added_error_motions(
        self, motion: Motion, time_s: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Deflection of the guide."""
        u = motion.share(self.axis, time_s)
        angle = np.radians(motion.position_mm(self.by, time_s)) + self.phase_rad
        sag = -1e-3 * self.amplitude_um * 4.0 * u * (1.0 - u) * np.sin(angle)
        return error_motion(f"E{self.direction}{self.axis}", sag)


@dataclass(frozen=True, slots=True)
class RotaryEccentricity(HiddenEffect):
    """amplitude (sin(angle + phase) − sin(phase)) of a ring scale off its axis."""

    name = "rotary-eccentricity"
    needs_model = True
    axis: str
    amplitude_urad: float
    phase_rad: float

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Random axis and phase."""
        amplitude = 1e3 * occasion.size_um / _REACH_MM
        phase = float(rng.uniform(0.0, 2.0 * np.pi))
        return cls(_choose_rotary(rng, occasion), amplitude, phase)

    def added_error_motions(
        self, motion: Motion, time_s: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Error of the angle."""
        angle = np.radians(motion.position_mm(self.axis, time_s)) + self.phase_rad
        wave = np.sin(angle) - np.sin(self.phase_rad)
        return _turn(motion, self.axis, 1e-6 * self.amplitude_urad * wave)
