"""Assign unnamed shots to commanded points by position and order."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64, Int64

from truepath.alignment.observations.measured_points import list_as_stops
from truepath.alignment.stream.nominal_path import compute_nominal_path
from truepath.alignment.stream.seating import find_seating
from truepath.alignment.stream.sequence import TOLERANCE_MM, match_stops
from truepath.errors import AlignmentError
from truepath.kinematics.machine.machine import Machine
from truepath.motion.configurations import Configurations


def order_shots(
    machine: Machine, points: Configurations, tracker_mm: Float64[np.ndarray, "n 3"]
) -> Int64[np.ndarray, " n"] | None:
    """Row of each shot, −1 off all points; None if shots do not follow them.

    Consecutive shots at one position are of one point; any point may be missing.
    """
    if not len(tracker_mm):
        return None
    step_mm = np.linalg.norm(np.diff(tracker_mm, axis=0), axis=1)
    stay = np.append(0, np.cumsum(step_mm > TOLERANCE_MM))
    count = np.bincount(stay)
    place_mm = np.stack(
        [np.bincount(stay, tracker_mm[:, axis]) / count for axis in range(3)], axis=1
    )
    nominal = compute_nominal_path(machine, points)
    try:
        found = match_stops(
            list_as_stops(place_mm),
            nominal.place_mm,
            ordered_by="points.csv",
            seating=find_seating(machine, points, nominal.first),
        )
    except AlignmentError:
        return None
    row = np.full(len(place_mm), -1)
    row[found.stop] = nominal.first[found.waypoint]
    return row[stay]
