"""Cut a stream into passes: stretches at constant feed along one commanded line each.

Between two matched standstills lies the line between their waypoints. Where standstills
are missing from the stream, the rough pose tells the lines apart. What is near a change
of direction (ramps, settling) is left out: there the place on the line is not known.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float64

from app.alignment.observations import Pass
from app.alignment.sequence import Matching
from app.alignment.stops import Stops, speed_mm_s
from app.numerics.rigid import RigidTransform

_ON_LINE_MM = 1.0  # farther than any machine error, nearer than any other line
_STEADY = 0.02  # relative change of speed that counts as a ramp
_SPEED_NOISE_MM_S = 0.8
_SHORTEST_S = 0.1


@dataclass(frozen=True, slots=True)
class Stream:
    """Valid samples in order of time; `pose` takes the workpiece to the tracker."""

    time_s: Float64[np.ndarray, " n"]
    tracker_mm: Float64[np.ndarray, "n 3"]
    pose: RigidTransform

    def points_mm(self, first: int, last: int) -> Float64[np.ndarray, "n 3"]:
        """Return a stretch of the samples in the workpiece frame."""
        return self.pose.inverse().apply(self.tracker_mm[first:last])


def cut_into_passes(
    stream: Stream,
    stops: Stops,
    matching: Matching,
    waypoint_mm: Float64[np.ndarray, "w 3"],
) -> tuple[Pass, ...]:
    """Return the passes in the order of time; `first` and `last` index `stream`."""
    found: list[Pass] = []
    for row, first, last in _stretches(stream, stops, matching, waypoint_mm):
        steady = _steady_part(stream, first, last, waypoint_mm[row - 1 : row + 1])
        if steady is not None:
            begin, end, speed = steady
            found.append(Pass(row, begin, end, speed))
    return tuple(found)


def _stretches(
    stream: Stream,
    stops: Stops,
    matching: Matching,
    waypoint_mm: Float64[np.ndarray, "w 3"],
) -> Iterator[tuple[int, int, int]]:
    """Yield (row, first, last) of what was driven between neighbouring standstills."""
    matched = dict(zip(matching.stop.tolist(), matching.waypoint.tolist(), strict=True))
    order = sorted(matched)
    for here, there in pairwise(order):
        a, b = matched[here], matched[there]
        # A standstill of no waypoint (a hold) ends one pass and begins another.
        for k in range(here, there):
            first, last = int(stops.last[k]), int(stops.first[k + 1])
            if last - first < 3:
                continue
            if b == a + 1:
                yield b, first, last
            else:
                yield from _told_by_place(stream, first, last, waypoint_mm, a, b)


def _told_by_place(
    stream: Stream,
    first: int,
    last: int,
    waypoint_mm: Float64[np.ndarray, "w 3"],
    a: int,
    b: int,
) -> Iterator[tuple[int, int, int]]:
    """Yield the stretches of the lines from a to b where their corners are lost."""
    points = stream.points_mm(first, last)
    away = np.stack(
        [
            _distance(points, waypoint_mm[r - 1], waypoint_mm[r])
            for r in range(a + 1, b + 1)
        ]
    )
    nearest = np.argmin(away, axis=0)
    nearest[away.min(axis=0) > _ON_LINE_MM] = -1
    for k in range(b - a):
        mine = np.flatnonzero(nearest == k)
        if len(mine) > 2:
            yield a + 1 + k, first + int(mine[0]), first + int(mine[-1]) + 1


def _distance(
    points: Float64[np.ndarray, "n 3"],
    begin: Float64[np.ndarray, "3"],
    end: Float64[np.ndarray, "3"],
) -> Float64[np.ndarray, " n"]:
    length = float(np.linalg.norm(end - begin))
    d = (end - begin) / max(length, 1e-12)
    along = np.clip((points - begin) @ d, 0.0, length)
    return np.linalg.norm(points - begin - along[:, None] * d, axis=1)


def _steady_part(
    stream: Stream, first: int, last: int, ends_mm: Float64[np.ndarray, "2 3"]
) -> tuple[int, int, float] | None:
    """Return first, last and speed of the part at constant feed, without ramps."""
    if float(np.linalg.norm(ends_mm[1] - ends_mm[0])) < _ON_LINE_MM:
        return None  # the target changed, the machine stood
    time, points = stream.time_s[first:last], stream.points_mm(first, last)
    on = _distance(points, ends_mm[0], ends_mm[1]) < _ON_LINE_MM
    if on.sum() < 20 or time[-1] - time[0] < _SHORTEST_S:
        return None
    speed = speed_mm_s(time, points)
    middle = (time > _part(time, 0.3)) & (time < _part(time, 0.7)) & on
    if middle.sum() < 10:
        middle = on
    plateau = float(np.median(speed[middle]))
    tolerance = max(_STEADY * plateau, _SPEED_NOISE_MM_S)
    steady = np.abs(speed - plateau) < tolerance
    begin, end = np.flatnonzero(steady)[[0, -1]] if steady.any() else (0, 0)
    # As long again as half the ramp, for what settles after it.
    t0 = time[begin] + 0.5 * (time[begin] - time[0]) + 0.02
    t1 = time[end] - 0.5 * (time[-1] - time[end]) - 0.02
    inside = np.flatnonzero((time >= t0) & (time <= t1) & on)
    if len(inside) < 20 or t1 - t0 < _SHORTEST_S:
        return None
    length = ends_mm[1] - ends_mm[0]
    along = points[inside] @ (length / np.linalg.norm(length))
    lag = time[inside] - time[inside].mean()
    speed = float(lag @ along / (lag @ lag))
    return first + int(inside[0]), first + int(inside[-1]) + 1, speed


def _part(time_s: Float64[np.ndarray, " n"], fraction: float) -> float:
    return float(time_s[0] + fraction * (time_s[-1] - time_s[0]))
