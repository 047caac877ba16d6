"""Points of a polled tracker: each sample names its commanded row.

Nothing is recognised from motion: a sample is the mean of a whole dwell. The sequence
of points still has to be that of the rows, so that a wrong numbering, another target or
a reflector that moved shows as a point off its row. Shots without a number are assigned
to rows by position and order.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64, Int64

from truepath.alignment.observations.cell_blocks import CellBlock
from truepath.alignment.observations.reduction import Cells, beam_frame
from truepath.alignment.stream.left_out import LeftOut
from truepath.alignment.stream.nominal_path import NominalPath, compute_nominal_path
from truepath.alignment.stream.seating import find_seating
from truepath.alignment.stream.sequence import TOLERANCE_MM, Matching, match_stops
from truepath.alignment.stream.stops import StopSequence
from truepath.errors import AlignmentError
from truepath.files.bundle.run import PointRows, Run
from truepath.kinematics.machine.machine import Machine
from truepath.motion.configurations import Configurations
from truepath_drivers.interfaces.records import TrackerSamples


def find_measured(samples: TrackerSamples) -> Int64[np.ndarray, " m"]:
    """Indices of the samples with status 0."""
    return np.flatnonzero(samples.status == 0)


def list_as_stops(tracker_mm: Float64[np.ndarray, "n 3"]) -> StopSequence:
    """Each point becomes a separate standstill of one sample."""
    number = np.arange(len(tracker_mm))
    return StopSequence(number, number + 1, tracker_mm)


def reduce_points(
    run: Run,
    points: PointRows,
    measured: Int64[np.ndarray, " m"],
    matching: Matching,
    nominal: NominalPath,
) -> tuple[list[CellBlock], list[LeftOut]]:
    """A cell for each point near its row, and exclusions for the others.

    measured : indices of the samples that are measurements
    """
    expected = matching.pose.apply(nominal.end_mm[points.row[measured]])
    tracker_mm = run.tracker.position_mm[measured]
    off_mm = np.linalg.norm(tracker_mm - expected, axis=1)
    parts: list[CellBlock] = []
    left_out: list[LeftOut] = []
    for sample, off in zip(measured.tolist(), off_mm.tolist(), strict=True):
        row, count = int(points.row[sample]), int(points.count[sample])
        time_s = float(run.tracker.device_time_s[sample])
        if off > matching.reach_mm:
            left_out.append(LeftOut("astray", row, time_s, time_s, count, off))
        else:
            parts.append(reduce_point(run, points, sample))
    return parts, left_out


def reduce_point(run: Run, points: PointRows, sample: int) -> CellBlock:
    """One cell; its scatter is 0 where the covariance is unknown."""
    row, tracker_mm = int(points.row[sample]), run.tracker.position_mm[[sample]]
    frame = beam_frame(tracker_mm)[0]
    square = np.diag(frame @ points.covariance_mm2[sample] @ frame.T)
    sigma = run.machine.tracker.sigma_mm(np.linalg.norm(tracker_mm, axis=1))[0]
    # An unknown covariance contains nothing on the scatter.
    free = float(points.count[sample] - 1) * bool(square.any())
    scatter = free * np.array([square[0], square[1] + square[2]]) / sigma**2
    cells = Cells(
        run.tracker.device_time_s[[sample]],
        tracker_mm,
        points.count[[sample]].astype(np.float64),
        scatter,
        np.array([free, 2.0 * free]),
        np.zeros(1, bool),
        np.empty(0),
    )
    position = run.commanded.position[[row]]
    return CellBlock(cells, row, -1, np.zeros((1, 3)), position, np.zeros(1))


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
