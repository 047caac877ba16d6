"""How long motions take, and which part of a line is driven at constant feed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.kinematics.machine import LinearAxis, Machine

# What alignment leaves out at either end beside ramp and settling.
_SETTLE_S = 0.02


@dataclass(frozen=True, slots=True)
class Drive:
    """What the machine can: acceleration along a line, and the dwell at its end.

    linear : (a,) which position columns are linear axes
    least_mm : no line takes the target less far
    fastest_deg_min : the feed is lowered where a rotary axis would turn faster
    """

    linear: tuple[bool, ...]
    acceleration_mm_s2: float
    dwell_s: float
    least_mm: float = 0.0
    fastest_deg_min: float = np.inf

    def length(
        self, begin: Float64[np.ndarray, "n a"], end: Float64[np.ndarray, "n a"]
    ) -> Float64[np.ndarray, " n"]:
        """Return the length of lines, mm; deg where rotary axes turn alone."""
        step = end - begin
        straight = np.asarray(self.linear)
        linear = np.asarray(np.linalg.norm(step[:, straight], axis=1), np.float64)
        turn = np.asarray(np.linalg.norm(step[:, ~straight], axis=1), np.float64)
        return np.where(linear > 0.0, linear, turn)

    def driven_feed(
        self,
        begin: Float64[np.ndarray, "n a"],
        end: Float64[np.ndarray, "n a"],
        feed_mm_min: Float64[np.ndarray, " n"],
    ) -> Float64[np.ndarray, " n"]:
        """Return the feeds, lowered where a rotary axis would turn too fast."""
        turn = np.abs(end - begin)[:, ~np.asarray(self.linear)].max(axis=1, initial=0.0)
        least_min = np.maximum(turn / self.fastest_deg_min, 1e-12)
        return np.minimum(feed_mm_min, self.length(begin, end) / least_min)

    def times_s(
        self,
        begin: Float64[np.ndarray, "n a"],
        end: Float64[np.ndarray, "n a"],
        feed_mm_min: Float64[np.ndarray, " n"],
    ) -> Float64[np.ndarray, " n"]:
        """Return the time of each line, exact stops and the dwell included."""
        length, feed = (
            self.length(begin, end),
            self.driven_feed(begin, end, feed_mm_min),
        )
        return (
            moving_s(length, np.maximum(feed, 1e-9), self.acceleration_mm_s2)
            + self.dwell_s
        )

    def steady(
        self,
        begin: Float64[np.ndarray, "n a"],
        end: Float64[np.ndarray, "n a"],
        feed_mm_min: Float64[np.ndarray, " n"],
    ) -> tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
        """Return the share of each line lost at either end, and the time of the rest.

        Lost is the ramp and what alignment leaves out beside it; all of a line that is
        too short.
        """
        length = np.maximum(self.length(begin, end), 1e-9)
        speed = np.maximum(self.driven_feed(begin, end, feed_mm_min) / 60.0, 1e-9)
        ramp_s = speed / self.acceleration_mm_s2
        # The ramp takes half its time at full speed; half of it again settles.
        lost = np.minimum(speed * (ramp_s + _SETTLE_S) / length, 0.5)
        return lost, (1.0 - 2.0 * lost) * length / speed

    def shortest_mm(self, feed_mm_min: float) -> float:
        """Return the shortest line worth its stops: most of it is driven steadily."""
        speed = feed_mm_min / 60.0
        steady_mm = 4.0 * speed * (speed / self.acceleration_mm_s2 + _SETTLE_S)
        return max(steady_mm, self.least_mm)


def moving_s(
    length: Float64[np.ndarray, " n"],
    feed_mm_min: Float64[np.ndarray, " n"],
    acceleration_mm_s2: float,
) -> Float64[np.ndarray, " n"]:
    """Return the time of moves from rest to rest; too short ones never reach the feed.

    Lengths in mm, or in deg with the feed in deg/min.
    """
    speed = feed_mm_min / 60.0
    ramp = speed / acceleration_mm_s2
    return np.where(
        length >= speed * ramp,
        length / speed + ramp,
        2.0 * np.sqrt(length / acceleration_mm_s2),
    )


def drive_of(machine: Machine, *, acceleration_mm_s2: float, dwell_s: float) -> Drive:
    """Return the drive of a machine's axes."""
    linear = tuple(isinstance(axis, LinearAxis) for axis in machine.axes)
    return Drive(linear, acceleration_mm_s2, dwell_s)
