"""Progress of an interrupted Run, and whether its set-up is unchanged.

Before a measurement continues, the machine returns to its last points, from the same
direction. Neither tracker nor reflector was moved if the reflector is seen at the same
points, to noise, repeatability and the tracker's own distance: points are compared in
the tracker's frame, for any move shows there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from truepath.alignment.align import align
from truepath.alignment.observations.observations import Observations
from truepath.alignment.stream.cleaning import find_valid_samples
from truepath.alignment.stream.nominal_path import compute_nominal_path, require_spread
from truepath.alignment.stream.stops import find_stops, rest_position_mm
from truepath.errors import AlignmentError
from truepath.files.bundle.run import Run
from truepath.kinematics.machine.tracker_noise import TrackerNoise
from truepath.motion.configurations import select_rows
from truepath_drivers.interfaces.records import Path

MOST_PLACES = 3  # compared, at most
_NOISE = 0.25  # of one sample's: after a second of samples, air included
_REPEATS_MM = 0.003  # machine and reflector, approached from the same side
_LIMIT = 4.0  # of the standard uncertainty of a difference
_SEARCHED_MM = 20.0  # a larger distance is no shift of the set-up


@dataclass(frozen=True)
class Committed:
    """Completed part of a Run, and the last points of the target.

    next_row : of the commanded rows: the line to it, or the point, is the first to
        measure
    row : (k,) rows of the last standstills, in the order of motion
    place_mm : (k, 3) position of the target, in the tracker's frame
    """

    next_row: int
    row: tuple[int, ...]
    place_mm: Float64[np.ndarray, "k 3"]


@dataclass(frozen=True)
class Closure:
    """Distance of the target from its points before the interruption.

    step_mm : the largest of the distances; allowed_mm : its limit
    """

    step_mm: float
    allowed_mm: float

    @property
    def agrees(self) -> bool:
        """True if the set-up is unchanged."""
        return self.step_mm <= self.allowed_mm


def find_committed(run: Run) -> Committed:
    """Progress of a Run. Raises AlignmentError where it does not determine a pose.

    A line counts with the standstill at its end, a point once its dwell is complete. A
    pose takes three points that are not on one straight line.
    """
    seen = align(run)
    still = seen.at.line < 0
    stood = sorted(set(seen.row[still].tolist()))
    if isinstance(run.commanded, Path):
        next_row = max(seen.measured_rows, default=0) + 1
        # The last line is whole only if the machine was seen at its end or beyond.
        if stood and stood[-1] < next_row - 1:
            next_row -= 1
    elif run.points is not None:
        next_row = int(run.points.row.max()) + 1
    else:
        next_row = _count_dwelt(run)
    whole = select_rows(run.commanded, slice(next_row))
    place_mm = compute_nominal_path(run.machine, whole).place_mm
    require_spread(place_mm, "what was driven")
    rows = [row for row in stood if row < next_row][-MOST_PLACES:]
    if not rows:
        raise AlignmentError("the machine was not seen to stand anywhere")
    place_mm = np.stack([_mean(seen, row, still) for row in rows])
    return Committed(next_row, tuple(rows), place_mm)


def locate_after_return(
    run: Run, place_mm: Float64[np.ndarray, "k 3"]
) -> Float64[np.ndarray, "k 3"]:
    """Present position of the target at each earlier point, in the same order.

    run : standstill points, of which these are the last. Raises AlignmentError where
        there are fewer standstills, or one is not near its point.
    """
    if run.points is not None:
        now_mm = run.tracker.position_mm[-len(place_mm) :]
    else:
        usable = np.flatnonzero(find_valid_samples(run.tracker, run.commanded.target))
        time_s = run.tracker.device_time_s[usable]
        position_mm = run.tracker.position_mm[usable]
        stops = find_stops(time_s, position_mm, 100.0)
        now_mm = np.array(
            [
                rest_position_mm(position_mm[first:last])
                for first, last in zip(stops.first, stops.last, strict=True)
            ]
        ).reshape(-1, 3)[-len(place_mm) :]
    if len(now_mm) < len(place_mm):
        raise AlignmentError(
            f"the target was seen at {len(now_mm)} places of {len(place_mm)}"
        )
    far_mm = np.linalg.norm(now_mm - place_mm, axis=1).max()
    if far_mm > _SEARCHED_MM:
        raise AlignmentError(
            f"the target is {far_mm:.0f} mm from where it was measured before"
        )
    return now_mm


def compare_points(
    before_mm: Float64[np.ndarray, "k 3"],
    now_mm: Float64[np.ndarray, "k 3"],
    noise: TrackerNoise,
) -> Closure:
    """Largest distance between both, with a limit of 4 standard uncertainties."""
    along_mm, across_mm = noise.sigma_mm(np.linalg.norm(before_mm, axis=1)).T
    variance = (_NOISE * along_mm) ** 2 + 2.0 * (_NOISE * across_mm) ** 2
    sigma_mm = np.sqrt(2.0 * (variance + _REPEATS_MM**2))
    step_mm = np.linalg.norm(now_mm - before_mm, axis=1)
    return Closure(float(step_mm.max()), _LIMIT * float(sigma_mm.max()))


def _count_dwelt(run: Run) -> int:
    last_s = float(run.tracker.device_time_s.max())
    done = 0
    for event in run.events:
        words = event.text.split()
        if event.kind == "point" and "until" in words:
            until_s = float(words[words.index("until") + 1])
            if until_s <= last_s:
                done = max(done, int(words[1]))
    return done


def _mean(seen: Observations, row: int, still: np.ndarray) -> np.ndarray:
    cells = still & (seen.row == row)
    count = seen.count[cells]
    return (count @ seen.tracker_mm[cells]) / count.sum()
