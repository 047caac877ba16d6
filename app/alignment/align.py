"""The room's door: one Run in, observations out."""

from __future__ import annotations

import numpy as np

from app.alignment.cleaning import valid_samples
from app.alignment.observations import Observations, Pass
from app.alignment.segmentation import Stream, cut_into_passes
from app.alignment.sequence import match_stops
from app.alignment.stops import find_stops
from app.alignment.stretches import (
    joined,
    moving_stretch,
    nominal_places_mm,
    standing_stretches,
)
from app.errors import AlignmentError
from app.kinematics.machine import RotaryAxis
from app.measurement.run import Run
from app.planning.configurations import Configurations
from drivers.interfaces.records import Path

_FEWEST_SAMPLES = 100
_SLOW_POSITIONING_MM_S = 10.0  # slowest traverse between points worth telling from rest


def align(run: Run) -> Observations:
    """Recognise what the machine did in the stream and reduce it to observations.

    Raises AlignmentError if stream and commanded path or points do not belong together.
    """
    valid = np.flatnonzero(valid_samples(run.tracker))
    if len(valid) < _FEWEST_SAMPLES:
        raise AlignmentError(
            f"the stream holds {len(valid)} valid samples; check beam and status"
        )
    time_s = run.tracker.device_time_s[valid]
    tracker_mm = run.tracker.position_mm[valid]
    _require_straight_lines(run)
    nominal_mm = nominal_places_mm(
        run.machine, run.commanded.position, run.commanded.target
    )
    stops = find_stops(time_s, tracker_mm, slowest_mm_s(run.commanded))
    commanded = "path.csv" if run.mode == "otf" else "points.csv"
    matching = match_stops(stops, nominal_mm, ordered_by=commanded)
    stream = Stream(time_s, tracker_mm, matching.pose)
    if run.mode == "standstill":
        parts = standing_stretches(run, stops, matching, stream)
        return joined(run, parts, matching.pose, ())
    passes = cut_into_passes(stream, stops, matching, nominal_mm)
    if not passes:
        raise AlignmentError(
            "no stretch at constant feed was found between the standstills; use longer "
            "lines or a lower feed"
        )
    moving = [
        moving_stretch(run, line, each, stream, nominal_mm)
        for line, each in enumerate(passes)
    ]
    in_run = tuple(
        Pass(p.row, int(valid[p.first]), int(valid[p.last - 1]) + 1, p.speed_mm_s)
        for p in passes
    )
    return joined(run, moving, matching.pose, in_run)


def _require_straight_lines(run: Run) -> None:
    """Refuse lines on which rotary axes turn: their places are not on a line."""
    if run.mode == "standstill":
        return
    for column, axis in enumerate(run.machine.axes):
        step = np.diff(run.commanded.position[:, column])
        if isinstance(axis, RotaryAxis) and step.any():
            row = int(np.flatnonzero(step)[0]) + 2
            raise AlignmentError(
                f"path.csv row {row + 1}: {axis.name} turns on the way; on the fly "
                "only straight axes are measured: turn between standstill points, "
                "in points.csv"
            )


def slowest_mm_s(commanded: Path | Configurations) -> float:
    """Return the slowest commanded motion."""
    if isinstance(commanded, Path):
        return float(np.min(commanded.feed_mm_min)) / 60.0
    return _SLOW_POSITIONING_MM_S
