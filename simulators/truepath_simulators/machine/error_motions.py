"""Random smooth error motions of axes, in the gauge of reported tables.

All six of a rotary axis are zero at the axis zero. Across the axis (two displacements,
two tilts) their mean over the travel is zero as well: that mean is the location of the
axis.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from truepath_simulators.machine_file import LinearAxis, RotaryAxis

_HARMONICS = np.arange(1, 5)
_GRID = 201  # positions for normalising


@dataclass(frozen=True, slots=True)
class ErrorMotion:
    """A smooth function of the axis position,

        f(s) = offset + slope (s - low) + sum_k amplitude_k cos(k pi u + phase_k),

    with u = (s - low) / (high - low). In mm or rad; slope per mm.
    """

    low_mm: float
    high_mm: float
    amplitude: tuple[float, ...] = ()
    phase: tuple[float, ...] = ()
    offset: float = 0.0
    slope: float = 0.0

    def at(self, position_mm: np.ndarray) -> np.ndarray:
        """Values at positions of any shape."""
        run_mm = position_mm - self.low_mm
        angle = np.pi / (self.high_mm - self.low_mm) * run_mm
        value = self.offset + self.slope * run_mm
        pairs = zip(self.amplitude, self.phase, strict=True)
        for k, (amplitude, phase) in enumerate(pairs, 1):
            value = value + amplitude * np.cos(k * angle + phase)
        return value

    def scale(self, factor: float) -> ErrorMotion:
        """`factor` times this motion."""
        return replace(
            self,
            amplitude=tuple(factor * a for a in self.amplitude),
            offset=factor * self.offset,
            slope=factor * self.slope,
        )

    def shift(self, offset: float, slope: float = 0.0) -> ErrorMotion:
        """The motion plus a straight line, `offset` at the lowest position."""
        return replace(self, offset=self.offset + offset, slope=self.slope + slope)


@dataclass(frozen=True, slots=True)
class JointedMotion:
    """A smooth motion with steps where pieces of a rack or of a guide meet.

    joint_mm : positions of the joints; step : height of each step, in mm or rad
    width_mm : of a step, as the teeth or rollers in contact bridge it
    """

    smooth: ErrorMotion
    joint_mm: tuple[float, ...]
    step: tuple[float, ...]
    width_mm: float

    def at(self, position_mm: np.ndarray) -> np.ndarray:
        value = self.smooth.at(position_mm)
        for joint, step in zip(self.joint_mm, self.step, strict=True):
            share = 2.0 * (position_mm - joint) / self.width_mm
            value = value + 0.5 * step * np.tanh(share)
        return value


def positioning(
    rng: np.random.Generator, axis: LinearAxis, peak_mm: float
) -> ErrorMotion:
    """Random positioning error: smooth, with a trend, zero at the axis zero."""
    trend = rng.uniform(-2.0, 2.0) / (axis.max_mm - axis.min_mm)
    return _zero_at_zero(_harmonics(rng, axis).shift(0.0, trend), axis, peak_mm)


def angular(rng: np.random.Generator, axis: LinearAxis, peak_rad: float) -> ErrorMotion:
    """Random roll, pitch or yaw: smooth, zero at the axis zero."""
    return _zero_at_zero(_harmonics(rng, axis), axis, peak_rad)


def straightness(
    rng: np.random.Generator, axis: LinearAxis, peak_mm: float
) -> ErrorMotion:
    """Random straightness error: smooth, its end-point line removed."""
    motion = _harmonics(rng, axis)
    first, last = motion.at(np.array([axis.min_mm, axis.max_mm]))
    slope = (last - first) / (axis.max_mm - axis.min_mm)
    return _scale_to(motion.shift(-float(first), -float(slope)), peak_mm)


def none(axis: LinearAxis) -> ErrorMotion:
    """Motion of a perfect guide."""
    return ErrorMotion(axis.min_mm, axis.max_mm)


def _harmonics(rng: np.random.Generator, axis: LinearAxis) -> ErrorMotion:
    return ErrorMotion(axis.min_mm, axis.max_mm, *_draw_harmonics(rng))


def _draw_harmonics(
    rng: np.random.Generator,
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    # Falling with k squared: the shape of ground guides and of scales, not of noise.
    amplitude = rng.normal(size=len(_HARMONICS)) / _HARMONICS**2
    phase = rng.uniform(0.0, 2.0 * np.pi, size=len(_HARMONICS))
    return tuple(amplitude.tolist()), tuple(phase.tolist())


def _zero_at_zero(motion: ErrorMotion, axis: LinearAxis, peak: float) -> ErrorMotion:
    at_zero = float(motion.at(np.array(axis.zero_mm)))
    return _scale_to(motion.shift(-at_zero), peak)


def _scale_to(motion: ErrorMotion, peak: float) -> ErrorMotion:
    grid = np.linspace(motion.low_mm, motion.high_mm, _GRID)
    return motion.scale(peak / float(np.abs(motion.at(grid)).max()))


_TURNING_GRID = 721  # half a degree of a full turn
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
    return _scale_turning(_draw_turning(rng, axis), peak)


def across_the_axis(
    rng: np.random.Generator, axis: RotaryAxis, peak: float
) -> TurningMotion:
    """Random radial motion or tilt: zero at the axis zero and in the mean."""
    motion = _draw_turning(rng, axis)
    unit = TurningMotion(axis, bend=1.0).mean()
    return _scale_turning(replace(motion, bend=-motion.mean() / unit), peak)


def _draw_turning(rng: np.random.Generator, axis: RotaryAxis) -> TurningMotion:
    motion = TurningMotion(axis, *_draw_harmonics(rng))
    at_zero = float(motion.at(np.array(axis.zero_deg)))
    return replace(motion, offset=motion.offset - at_zero)


def _scale_turning(motion: TurningMotion, peak: float) -> TurningMotion:
    grid = np.linspace(motion.axis.min_deg, motion.axis.max_deg, _TURNING_GRID)
    return motion.scale(peak / float(np.abs(motion.at(grid)).max()))
