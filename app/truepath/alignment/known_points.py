"""Known points: reflector positions that the tracker measures from every station.

The machine returns to them after the tracker was moved. Its positioning error is the
same both times, so a rigid motion from one station to the other has to fit to the
noise, the repeatability of the machine and the tracker's systematic errors.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from truepath.alignment.align import align
from truepath.alignment.observations.observations import Observations
from truepath.errors import AlignmentError
from truepath.files.bundle.run import Run
from truepath.kinematics.machine.tracker_noise import TrackerSpecification
from truepath.numerics.rigid import fit_rigid

_NOISE = 0.25  # of one sample's: after a second of samples, air included
_REPEATS_MM = 0.003  # machine and reflector, within minutes
_LIMIT = 4.0  # of the standard uncertainty of a point
_MOVED = 0.2  # of the planned move of the tracker


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


def hold_against_plan(
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


def _mean(seen: Observations, row: int) -> Float64[np.ndarray, "3"]:
    cells = seen.row == row
    count = seen.count[cells]
    return (count @ seen.tracker_mm[cells]) / count.sum()
