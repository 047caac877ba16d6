"""Points measured again: after an interruption, or from another station.

Before an interrupted measurement continues, the machine returns to its last points,
from the same direction. Neither tracker nor reflector was moved if the reflector is at
the same points in the tracker's frame, where any move shows.

After the tracker was moved, the machine returns to known points. Its positioning error
is the same both times, so a rigid motion from one station to the other has to fit.

Both limits are by noise, the repeatability of the machine and the tracker's errors.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from truepath.alignment.align import align
from truepath.alignment.observations.observations import Observations
from truepath.alignment.stream.cleaning import detect_valid_samples
from truepath.alignment.stream.nominal_path import compute_nominal_path, require_spread
from truepath.alignment.stream.stops import detect_stops, rest_position_mm
from truepath.errors import AlignmentError
from truepath.files.bundle.run import Run
from truepath.kinematics.machine.tracker_noise import TrackerNoise, TrackerSpecification
from truepath.motion.configurations import select_rows
from truepath.numerics.rigid import fit_rigid
from truepath_drivers.interfaces.records import Path

_MOST_PLACES = 3  # compared, at most
_NOISE = 0.25  # of one sample's: after a second of samples, air included
_REPEATS_MM = 0.003  # machine and reflector: the same approach, within minutes
_LIMIT = 4.0  # of the standard uncertainty of a difference
_SEARCHED_MM = 20.0  # a larger distance is no shift of the set-up
_MOVED = 0.2  # of the planned move of the tracker


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
        return self.step_mm <= self.allowed_mm


def measure_progress(run: Run) -> Committed:
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
    rows = [row for row in stood if row < next_row][-_MOST_PLACES:]
    if not rows:
        raise AlignmentError("the machine was not seen to stand anywhere")
    place_mm = np.stack([_mean(seen, row) for row in rows])
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
        usable = np.flatnonzero(detect_valid_samples(run.tracker, run.commanded.target))
        time_s = run.tracker.device_time_s[usable]
        position_mm = run.tracker.position_mm[usable]
        stops = detect_stops(time_s, position_mm, 100.0)
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


@dataclass(frozen=True)
class KnownPoints:
    """Known points as measured from one station.

    tracker_mm : (n, 3) in the tracker's frame
    sigma_mm : of a point; place_mm : of the tracker, in the frame that it is mounted on
    """

    tracker_mm: Float64[np.ndarray, "n 3"]
    sigma_mm: Float64[np.ndarray, " n"]
    place_mm: Float64[np.ndarray, "3"]


@dataclass(frozen=True)
class StationCheck:
    """Agreement of a new station with the previous one.

    moved_mm : of the tracker; residual_mm : root mean square distance of the points
        after the best rigid motion; allowed_mm : its limit
    problem : `not-seen`, `not-moved` or `residual` where the station cannot be used,
        text : its description
    """

    place_mm: Float64[np.ndarray, "3"]
    moved_mm: float
    residual_mm: float
    allowed_mm: float
    problem: str
    text: str


def measure_points(run: Run, specification: TrackerSpecification) -> KnownPoints:
    """Points of a Run at standstill, with uncertainties. Raises AlignmentError.

    specification : of the tracker's systematic errors
    """
    seen = align(run)
    count = len(run.commanded)
    if missing := sorted(set(range(count)) - set(seen.row.tolist())):
        numbers = ", ".join(str(k + 1) for k in missing)
        raise AlignmentError(f"known points {numbers} were not seen")
    point_mm = np.stack([_mean(seen, k) for k in range(count)])
    distance_mm = np.linalg.norm(point_mm, axis=1)
    along_mm, across_mm = run.machine.tracker.sigma_mm(distance_mm).T
    s = specification
    circles_urad = np.hypot(s.eccentricity_urad, s.encoder_urad), s.fine_urad
    turned_urad = [s.index_urad, *(2.0**0.5 * np.array([*circles_urad, s.tilt_urad]))]
    across_um = 2.0**0.5 * np.array([s.beam_offset_um, s.reflector_um])
    shifted_um = [s.range_offset_um, s.transit_offset_um, *across_um]
    parts = [
        _NOISE * along_mm,
        _NOISE * 2.0**0.5 * across_mm,
        1e-6 * float(np.linalg.norm(turned_urad)) * distance_mm,
        1e-6 * float(np.hypot(s.scale_ppm, s.scale_drift_ppm)) * distance_mm,
        1e-9 * s.bending_urad_per_m * distance_mm**2,
        np.full(count, 1e-3 * float(np.linalg.norm(shifted_um))),
        np.full(count, _REPEATS_MM),
    ]
    sigma_mm = np.sqrt(np.sum(np.square(parts), axis=0))
    place_mm = seen.pose.invert().translation_mm
    return KnownPoints(point_mm, sigma_mm, place_mm)


def compare_stations(
    before: KnownPoints, now: KnownPoints, asked_mm: float
) -> StationCheck:
    """Agreement of a station with the previous one.

    asked_mm : planned distance of the tracker's move
    """
    motion = fit_rigid(now.tracker_mm, before.tracker_mm)
    left = motion.apply(now.tracker_mm) - before.tracker_mm
    residual_mm = float(np.linalg.norm(left)) / float(np.sqrt(len(left)))
    variance = before.sigma_mm**2 + now.sigma_mm**2
    allowed_mm = _LIMIT * float(np.sqrt(np.mean(variance)))
    moved_mm = float(np.linalg.norm(motion.translation_mm))
    problem = text = ""
    if moved_mm < _MOVED * asked_mm:
        problem, text = (
            "not-moved",
            f"the tracker has not been moved: it stands {moved_mm:.0f} mm from its "
            f"last place, and was to go {asked_mm:.0f} mm",
        )
    elif residual_mm > allowed_mm:
        problem, text = (
            "residual",
            f"the known points are {1e3 * residual_mm:.0f} µm from where the last "
            f"station saw them, {1e3 * allowed_mm:.0f} µm are allowed; look at "
            "reflector and tracker",
        )
    return StationCheck(now.place_mm, moved_mm, residual_mm, allowed_mm, problem, text)


def compare_with_plan(
    now: KnownPoints, planned_mm: Float64[np.ndarray, "3"], asked_mm: float
) -> StationCheck:
    """Agreement of the first station with its planned position.

    It may be as far off as a further one, which has to go a fifth of the way at least.

    asked_mm : from its planned position to that of the next station
    """
    off_mm = float(np.linalg.norm(now.place_mm - planned_mm))
    problem = text = ""
    if off_mm > (1.0 - _MOVED) * asked_mm:
        problem, text = (
            "not-moved",
            f"the tracker has not been moved: it stands {off_mm:.0f} mm from the place "
            f"of station 1, and the next station is {asked_mm:.0f} mm from there",
        )
    return StationCheck(now.place_mm, off_mm, 0.0, 0.0, problem, text)


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


def _mean(seen: Observations, row: int) -> Float64[np.ndarray, "3"]:
    cells = (seen.at.line < 0) & (seen.row == row)
    count = seen.count[cells]
    return (count @ seen.tracker_mm[cells]) / count.sum()
