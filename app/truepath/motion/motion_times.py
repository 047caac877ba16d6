"""Motion times, the part of a line at constant feed, a short order of stops."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64, Int64

from truepath.kinematics.machine.machine import Machine, MotionLimits
from truepath.motion.configurations import Commanded
from truepath_drivers.interfaces.arcs import measure_length_mm
from truepath_drivers.interfaces.records import Path

DEFAULT_FEED_MM_MIN = 6000.0
USUAL_MOTION = MotionLimits()
FASTEST_DEG_MIN = 1800.0  # of a rotary axis on a line
_SHORTEST_MM = 100.0  # path of a target on a line while rotary axes turn
# Excluded by alignment at either end, in addition to ramp and settling.
_SETTLE_S = 0.02
_LEAST_S = 1e-9  # a gain beyond rounding


@dataclass(frozen=True, slots=True)
class Legs:
    """Motions from stop to stop, straight in axis positions, mm and deg."""

    begin: Float64[np.ndarray, "n a"]
    end: Float64[np.ndarray, "n a"]
    feed_mm_min: Float64[np.ndarray, " n"]

    def __len__(self) -> int:
        return len(self.begin)

    @property
    def step(self) -> Float64[np.ndarray, "n a"]:
        return self.end - self.begin


@dataclass(frozen=True, slots=True)
class Stops:
    """Stops in their order.

    position : mm and deg; feed_mm_min : towards each, the first unused
    """

    position: Float64[np.ndarray, "s a"]
    feed_mm_min: Float64[np.ndarray, " s"]

    def __len__(self) -> int:
        return len(self.position)

    @property
    def legs(self) -> Legs:
        return Legs(self.position[:-1], self.position[1:], self.feed_mm_min[1:])

    def select(self, of: slice) -> Stops:
        return Stops(self.position[of], self.feed_mm_min[of])

    def append(self, end: Float64[np.ndarray, " a"], feed_mm_min: float) -> Stops:
        feed = np.append(self.feed_mm_min, feed_mm_min)
        return Stops(np.vstack([self.position, end]), feed)


@dataclass(frozen=True, slots=True)
class Drive:
    """Motion of the machine along a line, and its dwell at the end.

    linear : (a,) mask of the linear axes among the position columns
    least_mm : shortest motion of the target on a line
    fastest_deg_min : the feed is lowered where a rotary axis would turn faster
    """

    linear: tuple[bool, ...]
    dwell_s: float
    limits: MotionLimits = USUAL_MOTION
    least_mm: float = 0.0
    fastest_deg_min: float = np.inf

    @classmethod
    def of(
        cls, axes: Sequence[str], dwell_s: float, limits: MotionLimits = USUAL_MOTION
    ) -> Drive:
        """X, Y and Z are linear."""
        return cls(tuple(name in "XYZ" for name in axes), dwell_s, limits)

    @classmethod
    def of_machine(cls, machine: Machine, dwell_s: float) -> Drive:
        return cls.of(machine.axis_names, dwell_s, machine.motion)

    @classmethod
    def of_lines(cls, machine: Machine, dwell_s: float) -> Drive:
        """For lines on which rotary axes may turn, with limits on turn and length."""
        drive = cls.of_machine(machine, dwell_s)
        if not machine.rotary_axes:
            return drive
        return replace(drive, least_mm=_SHORTEST_MM, fastest_deg_min=FASTEST_DEG_MIN)

    def turns(self, legs: Legs) -> Bool[np.ndarray, " n"]:
        turned = legs.step[:, ~np.asarray(self.linear)] != 0.0
        return np.asarray(turned.any(axis=1), np.bool_)

    def length(self, legs: Legs) -> Float64[np.ndarray, " n"]:
        """Length of each leg, mm; deg where rotary axes turn alone."""
        straight = np.asarray(self.linear)
        linear = np.asarray(np.linalg.norm(legs.step[:, straight], axis=1), np.float64)
        turn = np.asarray(np.linalg.norm(legs.step[:, ~straight], axis=1), np.float64)
        return np.where(linear > 0.0, linear, turn)

    def limited_feed(self, legs: Legs) -> Float64[np.ndarray, " n"]:
        """Feeds, lowered where a rotary axis would turn too fast."""
        turn = np.abs(legs.step)[:, ~np.asarray(self.linear)].max(axis=1, initial=0.0)
        least_min = np.maximum(turn / self.fastest_deg_min, 1e-12)
        return np.minimum(legs.feed_mm_min, self.length(legs) / least_min)

    def times_s(self, legs: Legs) -> Float64[np.ndarray, " n"]:
        """Time of each leg from rest to rest, plus the dwell."""
        speed = self.peak_mm_s(legs)
        return self.length(legs) / speed + self.ramp_s(speed) + self.dwell_s

    def peak_mm_s(self, legs: Legs) -> Float64[np.ndarray, " n"]:
        """Highest speed of each leg; a short one never reaches its feed.

        A ramp from rest to the speed p and back takes 2 t(p) and a length of p t(p).
        """
        limits, length = self.limits, np.maximum(self.length(legs), 1e-9)
        rise_s = limits.acceleration_mm_s2 / limits.jerk_mm_s3
        level = np.sqrt(rise_s**2 + 4.0 * length / limits.acceleration_mm_s2) - rise_s
        highest = 0.5 * limits.acceleration_mm_s2 * level
        if np.isfinite(limits.jerk_mm_s3):
            short = (0.5 * length * limits.jerk_mm_s3**0.5) ** (2.0 / 3.0)
            highest = np.where(
                highest < limits.acceleration_mm_s2 * rise_s, short, highest
            )
        return np.minimum(np.maximum(self.limited_feed(legs) / 60.0, 1e-9), highest)

    def ramp_s(
        self, speed_mm_s: Float64[np.ndarray, " n"]
    ) -> Float64[np.ndarray, " n"]:
        """Time from rest to a speed, jerk limited."""
        limits = self.limits
        rise_s = limits.acceleration_mm_s2 / limits.jerk_mm_s3
        return np.where(
            speed_mm_s >= limits.acceleration_mm_s2 * rise_s,
            speed_mm_s / limits.acceleration_mm_s2 + rise_s,
            2.0 * np.sqrt(speed_mm_s / limits.jerk_mm_s3),
        )

    def steady(
        self, legs: Legs
    ) -> tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
        """Share of each line lost at either end, and the time of the remaining part.

        Lost is the ramp and what alignment excludes next to it; all of a line that is
        too short.
        """
        length = np.maximum(self.length(legs), 1e-9)
        speed = self.peak_mm_s(legs)
        ramp_s = self.ramp_s(speed)
        # The ramp takes half its time at full speed; half of it again settles.
        lost = np.minimum(speed * (ramp_s + _SETTLE_S) / length, 0.5)
        return lost, (1.0 - 2.0 * lost) * length / speed

    def shortest_mm(
        self, feed_mm_min: float | Float64[np.ndarray, " n"]
    ) -> Float64[np.ndarray, " n"]:
        """Shortest line worth its stops: most of it is at a steady feed."""
        speed = np.atleast_1d(np.asarray(feed_mm_min, np.float64)) / 60.0
        steady_mm = 4.0 * speed * (self.ramp_s(speed) + _SETTLE_S)
        return np.maximum(steady_mm, self.least_mm)


def row_times_s(
    commanded: Commanded,
    feed_mm_min: float = DEFAULT_FEED_MM_MIN,
    limits: MotionLimits = USUAL_MOTION,
) -> Float64[np.ndarray, " n"]:
    """Time of each row: the line towards it, exact stops, and its dwell.

    The first row counts its dwell alone. The feed is that of the linear axes; where
    none moves it is that of the rotary axes, in deg/min (formats.md), with the same
    figure for their acceleration in deg/s².

    feed_mm_min : between points; a path has its own
    """
    feed = np.full(len(commanded), feed_mm_min)
    if isinstance(commanded, Path):
        feed = commanded.feed_mm_min
    legs = Stops(commanded.position, feed).legs
    if isinstance(commanded, Path) and any(commanded.arc):
        legs = _unroll_arcs(commanded, legs)
    moving_s = Drive.of(commanded.axes, 0.0, limits).times_s(legs)
    return np.concatenate([[0.0], moving_s]) + commanded.dwell_s


def _unroll_arcs(path: Path, legs: Legs) -> Legs:
    """Legs as long as the arcs are, straight along their first axis."""
    end = legs.end.copy()
    for row, arc in enumerate(path.arc[1:]):
        if arc is not None:
            begin = path.position[row]
            end[row] = begin
            length_mm = measure_length_mm(path.axes, begin, arc)
            end[row, path.axes.index(arc.axes[0])] += length_mm
    return replace(legs, end=end)


def travel_time_s(path: Path, limits: MotionLimits = USUAL_MOTION) -> float:
    """Time of the path from its first row, dwells included."""
    return float(row_times_s(path, limits=limits).sum())


def find_short_order(time_s: Float64[np.ndarray, "n n"]) -> Int64[np.ndarray, " n"]:
    """An order of stops in which no reversal of a stretch gains anything.

    The first one stays. Croes (1958), the end being free.

    time_s : of the move between any two, symmetric; very long where it is not allowed
    """
    order = np.arange(len(time_s))
    while True:
        gain, first, last = _find_best_reversal(time_s, order)
        if gain < _LEAST_S:
            return order
        order[first : last + 1] = order[first : last + 1][::-1].copy()


def _find_best_reversal(
    time_s: Float64[np.ndarray, "n n"], order: Int64[np.ndarray, " n"]
) -> tuple[float, int, int]:
    between = time_s[np.ix_(order, order)]
    n = len(order)
    if n < 3:
        return 0.0, 0, 0
    step = np.append(np.diagonal(between, 1), 0.0)  # no move after the last stop
    after = np.hstack([between[:, 1:], np.zeros((n, 1))])
    # Before: i−1 → i … j → j+1; turned round: i−1 → j … i → j+1.
    gain = step[:-1, None] + step[None, 1:] - between[:-1, 1:] - after[1:, 1:]
    gain = np.triu(np.where(np.isfinite(gain), gain, -np.inf), 1)
    i, j = np.unravel_index(int(np.argmax(gain)), gain.shape)
    return float(gain[i, j]), int(i) + 1, int(j) + 1
