"""Random smooth error motions of a rotary axis, in the gauge of reported tables.

All six are zero at the axis zero. Across the axis (two displacements, two tilts) their
mean over the travel is zero as well: that mean is the location of the axis.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from truepath_simulators.machine_file import RotaryAxis

_HARMONICS = np.arange(1, 5)
_GRID = 721  # half a degree of a full turn
_NODE, _WEIGHT = np.polynomial.legendre.leggauss(64)


@dataclass(frozen=True, slots=True)
class TurningMotion:
    """A smooth function of the angle,

        f(c) = offset + bend (1 - cos(c - zero)) + sum_k a_k cos(k w u + phase_k),

    u = c - low in rad; w = 1 where the axis turns fully, else pi over the travel. In mm
    or rad.
    """

    axis: RotaryAxis
    amplitude: tuple[float, ...] = ()
    phase: tuple[float, ...] = ()
    offset: float = 0.0
    bend: float = 0.0

    def at(self, position_deg: np.ndarray) -> np.ndarray:
        """Values at positions of any shape."""
        run = np.radians(position_deg - self.axis.min_deg)
        travel = np.radians(self.axis.max_deg - self.axis.min_deg)
        rate = 1.0 if self.axis.turns_fully else np.pi / travel
        turned = np.radians(position_deg - self.axis.zero_deg)
        value = self.offset + self.bend * (1.0 - np.cos(turned))
        pairs = zip(self.amplitude, self.phase, strict=True)
        for k, (amplitude, phase) in enumerate(pairs, 1):
            value = value + amplitude * np.cos(k * rate * run + phase)
        return value

    def scale(self, factor: float) -> TurningMotion:
        """`factor` times this motion."""
        return replace(
            self,
            amplitude=tuple(factor * a for a in self.amplitude),
            offset=factor * self.offset,
            bend=factor * self.bend,
        )

    def mean(self) -> float:
        """Mean over the travel."""
        low, high = self.axis.min_deg, self.axis.max_deg
        return float(_WEIGHT @ self.at(low + (_NODE + 1.0) / 2.0 * (high - low)) / 2.0)


def along_the_axis(
    rng: np.random.Generator, axis: RotaryAxis, peak: float
) -> TurningMotion:
    """Random axial motion or positioning error: zero at the axis zero."""
    return _scale_to(_zero_at_zero(_harmonics(rng, axis)), peak)


def across_the_axis(
    rng: np.random.Generator, axis: RotaryAxis, peak: float
) -> TurningMotion:
    """Random radial motion or tilt: zero at the axis zero and in the mean."""
    motion = _zero_at_zero(_harmonics(rng, axis))
    unit = TurningMotion(axis, bend=1.0).mean()
    return _scale_to(replace(motion, bend=-motion.mean() / unit), peak)


def _harmonics(rng: np.random.Generator, axis: RotaryAxis) -> TurningMotion:
    amplitude = rng.normal(size=len(_HARMONICS)) / _HARMONICS**2
    phase = rng.uniform(0.0, 2.0 * np.pi, size=len(_HARMONICS))
    return TurningMotion(axis, tuple(amplitude.tolist()), tuple(phase.tolist()))


def _zero_at_zero(motion: TurningMotion) -> TurningMotion:
    at_zero = float(motion.at(np.array(motion.axis.zero_deg)))
    return replace(motion, offset=motion.offset - at_zero)


def _scale_to(motion: TurningMotion, peak: float) -> TurningMotion:
    grid = np.linspace(motion.axis.min_deg, motion.axis.max_deg, _GRID)
    return motion.scale(peak / float(np.abs(motion.at(grid)).max()))
