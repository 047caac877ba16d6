"""Feed along one line with limited acceleration and jerk, in closed form.

A ride is a list of stretches of constant jerk. Between standstills it has the standard
seven: up to the feed, along, down to zero. Limits hold along the path.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

_BISECTIONS = 60  # to the last digit of a float


@dataclass(frozen=True, slots=True)
class Limits:
    """Largest acceleration and jerk along the path; infinite jerk gives trapezoids."""

    acceleration_mm_s2: float = 1500.0
    jerk_mm_s3: float = 30_000.0


class Stretch(NamedTuple):
    """Constant jerk for a time, from an acceleration onwards."""

    duration_s: float
    acceleration: float
    jerk: float


def rest_to_rest(
    length_mm: np.ndarray, feed_mm_s: np.ndarray, limits: Limits
) -> np.ndarray:
    """Seven stretches for each line, (n, 7, 3), as duration, acceleration, jerk.

    length_mm, feed_mm_s : (n,), positive. A line too short for its feed peaks below it.
    """
    peak = np.minimum(feed_mm_s, _highest_peak(length_mm, limits))
    ramp, level = _ramp_and_level(peak, limits)
    ramps_mm = peak * (2.0 * ramp + level)
    cruise = np.maximum(length_mm - ramps_mm, 0.0) / peak
    top = np.where(ramp + level > 0.0, peak / (ramp + level), 0.0)
    jerk = np.divide(top, ramp, out=np.zeros_like(ramp), where=ramp > 0.0)
    none = np.zeros_like(ramp)
    durations = [ramp, level, ramp, cruise, ramp, level, ramp]
    accelerations = [none, top, top, none, none, -top, -top]
    jerks = [jerk, none, -jerk, none, -jerk, none, jerk]
    return np.stack(
        [np.stack(values, axis=1) for values in (durations, accelerations, jerks)],
        axis=2,
    )


def brake(speed: float, acceleration: float, limits: Limits) -> list[Stretch]:
    """Shortest stretches from a speed and acceleration to standstill."""
    A, J = limits.acceleration_mm_s2, limits.jerk_mm_s3
    if speed <= 0.0:
        return []
    if math.isinf(J):
        return [Stretch(speed / A, -A, 0.0)]
    # v = p^2 / J - a^2 / (2 J) is lost where the deceleration peaks at p, never level.
    peak = max(math.sqrt(J * speed + acceleration**2 / 2.0), -acceleration)
    level = 0.0
    if peak > A:
        peak = max(A, -acceleration)
        level = (speed + (acceleration**2 - 2.0 * peak**2) / (2.0 * J)) / peak
    return [
        Stretch((acceleration + peak) / J, acceleration, -J),
        Stretch(max(level, 0.0), -peak, 0.0),
        Stretch(peak / J, -peak, J),
    ]


def ride(
    length_mm: float,
    feed_mm_s: float,
    speed: float,
    acceleration: float,
    limits: Limits,
) -> list[Stretch] | None:
    """Stretches from a speed and acceleration to standstill after a length.

    None if the machine already brakes for the end and has no alternative.
    """

    def way(peak: float) -> list[Stretch]:
        settled, settling = _settle(speed, acceleration, limits)
        return [
            *settling,
            *_change(settled, peak, limits),
            *_change(peak, 0.0, limits),
        ]

    def overrun(peak: float) -> float:
        return _travel(way(peak), speed) - length_mm

    if overrun(0.0) > 0.0:
        return None
    peak = feed_mm_s
    if overrun(peak) > 0.0:
        peak = _bisect_speed(overrun, feed_mm_s)
    cruise = Stretch(max(-overrun(peak), 0.0) / peak, 0.0, 0.0)
    stretches = way(peak)
    last = len(_change(peak, 0.0, limits))
    return [*stretches[:-last], cruise, *stretches[-last:]]


def _highest_peak(length_mm: np.ndarray, limits: Limits) -> np.ndarray:
    A, J = limits.acceleration_mm_s2, limits.jerk_mm_s3
    if math.isinf(J):
        return np.sqrt(A * length_mm)
    without_level = (0.5 * length_mm * math.sqrt(J)) ** (2.0 / 3.0)
    ramp = A / J
    with_level = 0.5 * A * (np.sqrt(ramp**2 + 4.0 * length_mm / A) - ramp)
    return np.where(without_level <= A**2 / J, without_level, with_level)


def _ramp_and_level(
    change_mm_s: np.ndarray, limits: Limits
) -> tuple[np.ndarray, np.ndarray]:
    A, J = limits.acceleration_mm_s2, limits.jerk_mm_s3
    if math.isinf(J):
        return np.zeros_like(change_mm_s), change_mm_s / A
    ramp = np.minimum(np.sqrt(change_mm_s / J), A / J)
    return ramp, np.maximum(change_mm_s / A - A / J, 0.0)


def _change(before: float, after: float, limits: Limits) -> list[Stretch]:
    sign = 1.0 if after >= before else -1.0
    ramp, level = (
        float(t) for t in _ramp_and_level(np.array(abs(after - before)), limits)
    )
    if ramp + level == 0.0:
        return [Stretch(0.0, 0.0, 0.0)]
    top = (after - before) / (ramp + level)
    jerk = 0.0 if ramp == 0.0 else sign * abs(top) / ramp
    return [
        Stretch(ramp, 0.0, jerk),
        Stretch(level, top, 0.0),
        Stretch(ramp, top, -jerk),
    ]


def _settle(
    speed: float, acceleration: float, limits: Limits
) -> tuple[float, list[Stretch]]:
    J = limits.jerk_mm_s3
    if acceleration == 0.0 or math.isinf(J):
        return speed, []
    duration = abs(acceleration) / J
    stretch = Stretch(duration, acceleration, -math.copysign(J, acceleration))
    return max(speed + 0.5 * acceleration * duration, 0.0), [stretch]


def _travel(stretches: list[Stretch], speed: float) -> float:
    distance = 0.0
    for t, a, j in stretches:
        distance += speed * t + a * t**2 / 2.0 + j * t**3 / 6.0
        speed += a * t + j * t**2 / 2.0
    return distance


def _bisect_speed(overrun: Callable[[float], float], high: float) -> float:
    """Highest speed that does not overrun; `high` does."""
    low = 0.0
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        if overrun(middle) > 0.0:
            high = middle
        else:
            low = middle
    return low
