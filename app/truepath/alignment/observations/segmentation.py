"""Cut a stream into passes: one commanded line each, constant feed and ramps.

Between two matched standstills lies the line between their waypoints. Where standstills
are missing from the stream, the rough pose distinguishes the lines. On ramps the
position on the line does not follow from the feed; there the measured one is used, and
only deviations across the line count. Settling after a standstill is excluded.

A line on which rotary axes turn is a curve of the target, whose speed changes on the
way. Uniform at a constant feed is the share of the line per second.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float64

from truepath.alignment.observations.observations import ArcDrive, Pass
from truepath.alignment.stream.nominal_path import MIN_MOTION_MM, Curve, NominalPath
from truepath.alignment.stream.sequence import TOLERANCE_MM, Matching
from truepath.alignment.stream.stops import StopSequence, speed_mm_s
from truepath.numerics.rigid import RigidTransform

_STEADY = 0.02  # relative change of speed that counts as a ramp
_SPEED_NOISE_MM_S = 0.8  # tolerance of a speed at the least, for the tracker's noise
_SHORTEST_S = 0.1  # a pass
_FEWEST_SAMPLES = 8  # of a pass
_FEWEST_ON_RAMP = 5
RAMP_SETTLE_S = 0.03  # after a standstill, and before one
_SLOW_PACE = 0.2  # of its mean speed: slower, the target does not give the share
_AGREES = 0.05  # distance and speed have to agree


@dataclass(frozen=True, slots=True)
class Stream:
    """Valid samples in order of time; `pose` maps workpiece to tracker.

    reach_mm : largest deviation of the machine from its line: nearer than any other
        line
    """

    time_s: Float64[np.ndarray, " n"]
    tracker_mm: Float64[np.ndarray, "n 3"]
    pose: RigidTransform
    reach_mm: float = TOLERANCE_MM

    def points_mm(self, first: int, last: int) -> Float64[np.ndarray, "n 3"]:
        return self.pose.invert().apply(self.tracker_mm[first:last])


@dataclass(frozen=True, slots=True)
class _Part:
    """Executed part of a line: samples from first to last.

    origin : sample at which the line began; below 0 where it is not known
    is_whole : it began and ended at its standstills
    """

    row: int
    first: int
    last: int
    origin: int = -1
    is_complete: bool = False


def cut_into_passes(
    stream: Stream, stops: StopSequence, matching: Matching, nominal: NominalPath
) -> tuple[Pass, ...]:
    """In order of time; `first` and `last` index `stream`."""
    passes = (
        _recognise_pass(stream, part, nominal.curve(part.row))
        for part in _split_into_lines(stream, stops, matching, nominal)
        if part.row not in nominal.arcs
    )
    return tuple(p for p in passes if p is not None)


def find_arc_drives(
    stream: Stream, stops: StopSequence, matching: Matching, nominal: NominalPath
) -> tuple[ArcDrive, ...]:
    return tuple(
        ArcDrive(part.row, part.first, part.last)
        for part in _split_into_lines(stream, stops, matching, nominal)
        if part.row in nominal.arcs and part.is_complete
    )


def _split_into_lines(
    stream: Stream, stops: StopSequence, matching: Matching, nominal: NominalPath
) -> Iterator[_Part]:
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
                row = int(nominal.first[b])
                origin = int(stops.last[here])
                yield _Part(row, first, last, origin, there == here + 1)
            else:
                rows = range(int(nominal.last[a]) + 1, int(nominal.first[b]) + 1)
                yield from _split_by_position(stream, first, last, nominal, rows)


def _split_by_position(
    stream: Stream, first: int, last: int, nominal: NominalPath, rows: range
) -> Iterator[_Part]:
    points = stream.points_mm(first, last)
    away = np.stack([nominal.curve(row).nearest(points)[1] for row in rows])
    nearest = np.argmin(away, axis=0)
    nearest[away.min(axis=0) > stream.reach_mm] = -1
    for k, row in enumerate(rows):
        mine = np.flatnonzero(nearest == k)
        if len(mine) > 2:
            yield _Part(row, first + int(mine[0]), first + int(mine[-1]) + 1)


def _recognise_pass(stream: Stream, part: _Part, curve: Curve) -> Pass | None:
    if curve.length_mm < MIN_MOTION_MM:
        return None  # the target changed, or hardly moves
    first, last = part.first, part.last
    time, points = stream.time_s[first:last], stream.points_mm(first, last)
    share, away = curve.nearest(points, _path_length_mm(stream, part, curve))
    on = away < stream.reach_mm
    if on.sum() < _FEWEST_SAMPLES or time[-1] - time[0] < _SHORTEST_S:
        return None
    steady = _find_steady(time, points, share, on, curve)
    ramps = (
        _find_ramps(time, share, on, curve, steady, part) if part.is_complete else ()
    )
    if steady is None and not ramps:
        return None
    begin, end, speed, middle = steady or (0, 0, 0.0, 0.0)
    return Pass(part.row, first + begin, first + end, speed, middle, ramps)


def _find_steady(
    time: Float64[np.ndarray, " n"],
    points: Float64[np.ndarray, "n 3"],
    share: Float64[np.ndarray, " n"],
    on: Bool[np.ndarray, " n"],
    curve: Curve,
) -> tuple[int, int, float, float] | None:
    """First and last sample, speed, share at mid time; None without such a part."""
    speed, pace = speed_mm_s(time, points), curve.relative_speed(share)
    counted = on & (pace > _SLOW_PACE)
    middle = (time > _time_at(time, 0.3)) & (time < _time_at(time, 0.7)) & counted
    if middle.sum() < _FEWEST_SAMPLES // 2:
        middle = counted
    if not middle.any():
        return None
    plateau = float(np.median(speed[middle] / pace[middle]))
    tolerance = np.maximum(_STEADY * plateau * pace, _SPEED_NOISE_MM_S)
    steady = (np.abs(speed - plateau * pace) < tolerance) & (pace > _SLOW_PACE)
    begin, end = np.flatnonzero(steady)[[0, -1]] if steady.any() else (0, 0)
    # As long again as half the ramp, for what settles after it.
    t0 = time[begin] + 0.5 * (time[begin] - time[0]) + 0.02
    t1 = time[end] - 0.5 * (time[-1] - time[end]) - 0.02
    inside = np.flatnonzero((time >= t0) & (time <= t1) & on)
    if len(inside) < _FEWEST_SAMPLES or t1 - t0 < _SHORTEST_S:
        return None
    rate, middle_share = _fit_even_feed(time[inside], share[inside], pace[inside])
    mean_speed = rate * curve.length_mm
    gone_mm = float(np.ptp(share[inside])) * curve.length_mm
    if abs(mean_speed - plateau) > _AGREES * plateau or gone_mm < MIN_MOTION_MM:
        return None
    return int(inside[0]), int(inside[-1]) + 1, mean_speed, middle_share


def _find_ramps(
    time: Float64[np.ndarray, " n"],
    share: Float64[np.ndarray, " n"],
    on: Bool[np.ndarray, " n"],
    curve: Curve,
    steady: tuple[int, int, float, float] | None,
    part: _Part,
) -> tuple[tuple[int, int], ...]:
    """First and last sample of stretches with changing feed.

    Of straight lines only: on a curve the position does not separate the deviation
    across it. The first part, in which the machine settles into its motion, is
    excluded, and the last.
    """
    if not curve.is_straight:
        return ()
    settled = (time > time[0] + RAMP_SETTLE_S) & (time < time[-1] - RAMP_SETTLE_S)
    usable = np.flatnonzero(on & settled & (share > 0.0) & (share < 1.0))
    ends = (
        [usable]
        if steady is None
        else [usable[usable < steady[0]], usable[usable >= steady[1]]]
    )
    return tuple(
        (part.first + int(end[0]), part.first + int(end[-1]) + 1)
        for end in ends
        if len(end) >= _FEWEST_ON_RAMP
        and np.ptp(share[end]) * curve.length_mm > MIN_MOTION_MM
    )


def _path_length_mm(
    stream: Stream, part: _Part, curve: Curve
) -> Float64[np.ndarray, " n"] | None:
    if curve.is_straight or part.origin < 0:
        return None
    time = stream.time_s[part.origin : part.last]
    step = np.diff(time, prepend=time[:1])
    speed = speed_mm_s(time, stream.tracker_mm[part.origin : part.last])
    return np.cumsum(speed * step)[part.first - part.origin :]


def _fit_even_feed(
    time_s: Float64[np.ndarray, " n"],
    share: Float64[np.ndarray, " n"],
    pace: Float64[np.ndarray, " n"],
) -> tuple[float, float]:
    weight = pace**2 / (pace @ pace)
    lag = time_s - weight @ time_s
    rate = float((weight * lag) @ share / ((weight * lag) @ lag))
    middle = 0.5 * (time_s[0] + time_s[-1]) - weight @ time_s
    return rate, float(weight @ share + rate * middle)


def _time_at(time_s: Float64[np.ndarray, " n"], fraction: float) -> float:
    return float(time_s[0] + fraction * (time_s[-1] - time_s[0]))
