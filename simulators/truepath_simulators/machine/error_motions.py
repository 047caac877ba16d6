"""Random smooth error motions of a linear axis, in the gauge of reported tables."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truepath_simulators.machine_file import LinearAxis

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
        return ErrorMotion(
            self.low_mm,
            self.high_mm,
            tuple(factor * a for a in self.amplitude),
            self.phase,
            factor * self.offset,
            factor * self.slope,
        )

    def shift(self, offset: float, slope: float = 0.0) -> ErrorMotion:
        """The motion plus a straight line, `offset` at the lowest position."""
        return ErrorMotion(
            self.low_mm,
            self.high_mm,
            self.amplitude,
            self.phase,
            self.offset + offset,
            self.slope + slope,
        )


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
        """Values at positions of any shape."""
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
    # Falling with k squared: the shape of ground guides and of scales, not of noise.
    amplitude = rng.normal(size=len(_HARMONICS)) / _HARMONICS**2
    phase = rng.uniform(0.0, 2.0 * np.pi, size=len(_HARMONICS))
    return ErrorMotion(
        axis.min_mm, axis.max_mm, tuple(amplitude.tolist()), tuple(phase.tolist())
    )


def _zero_at_zero(motion: ErrorMotion, axis: LinearAxis, peak: float) -> ErrorMotion:
    at_zero = float(motion.at(np.array(axis.zero_mm)))
    return _scale_to(motion.shift(-at_zero), peak)


def _scale_to(motion: ErrorMotion, peak: float) -> ErrorMotion:
    grid = np.linspace(motion.low_mm, motion.high_mm, _GRID)
    return motion.scale(peak / float(np.abs(motion.at(grid)).max()))
