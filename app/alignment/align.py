"""The room's door: one Run in, observations out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from app.alignment.cleaning import valid_samples
from app.alignment.observations import Observations, Pass
from app.alignment.reduction import Cells, reduce_to_cells
from app.alignment.segmentation import Stream, cut_into_passes
from app.alignment.sequence import Matching, match_stops
from app.alignment.stops import Stops, find_stops
from app.errors import AlignmentError
from app.kinematics.chain import nominal_point_mm
from app.kinematics.effects.base import Conditions
from app.kinematics.machine import Machine
from app.measurement.run import Run
from drivers.interfaces.records import Path

_SETTLE_S = 0.05
_SLOW_POSITIONING_MM_S = 10.0  # slowest traverse between standstill points worth naming


@dataclass(frozen=True, slots=True)
class _Stretch:
    """Cells of one pass or one standstill, with what was commanded there."""

    cells: Cells
    row: int
    line: int
    velocity_mm_s: Float64[np.ndarray, "3"]
    position_mm: Float64[np.ndarray, "n a"]
    line_time_s: Float64[np.ndarray, " n"]


def align(run: Run) -> Observations:
    """Recognise what the machine did in the stream and reduce it to observations.

    Raises AlignmentError if stream and commanded path or points do not belong together.
    """
    valid = np.flatnonzero(valid_samples(run.tracker))
    if len(valid) < 100:
        raise AlignmentError(
            f"the stream holds {len(valid)} valid samples; check the beam and the status"
        )
    time_s = run.tracker.device_time_s[valid]
    tracker_mm = run.tracker.position_mm[valid]
    nominal = nominal_point_mm(
        run.machine, run.commanded.position, offsets_mm(run.machine, run.commanded.target, len(run.commanded))
    )
    on_the_fly = isinstance(run.commanded, Path)
    stops = find_stops(time_s, tracker_mm, _slowest_mm_s(run))
    matching = match_stops(
        stops, nominal, ordered_by="path.csv" if on_the_fly else "points.csv"
    )
    if on_the_fly:
        stream = Stream(time_s, matching.pose.inverse().apply(tracker_mm), valid)
        passes = cut_into_passes(stream, stops, matching, nominal)
        stretches = [
            _moving(run, k, p, time_s, tracker_mm, nominal, matching)
            for k, p in enumerate(passes)
        ]
        named = tuple(
            Pass(p.row, int(valid[p.first]), int(valid[p.last - 1]) + 1, p.speed_mm_s)
            for p in passes
        )
    else:
        stretches = _standing(run, stops, matching, time_s, tracker_mm)
        named = ()
    if not stretches:
        raise AlignmentError(
            "no stretch at constant feed was found between the standstills; use longer "
            "lines or a lower feed"
        )
    return _joined(run, stretches, matching, named)


def offsets_mm(
    machine: Machine, targets: tuple[str, ...], rows: int
) -> Float64[np.ndarray, "n 3"]:
    """Return the offset of the target measured at each commanded row."""
    if not targets:
        return np.tile(np.array(machine.target().offset_mm, float), (rows, 1))
    return np.array([machine.target(name).offset_mm for name in targets], float)


def _slowest_mm_s(run: Run) -> float:
    if isinstance(run.commanded, Path):
        return float(np.min(run.commanded.feed_mm_min)) / 60.0
    return _SLOW_POSITIONING_MM_S


def _moving(
    run: Run,
    line: int,
    stretch: Pass,
    time_s: Float64[np.ndarray, " n"],
    tracker_mm: Float64[np.ndarray, "n 3"],
    nominal_mm: Float64[np.ndarray, "w 3"],
    matching: Matching,
) -> _Stretch:
    begin, end = nominal_mm[stretch.row - 1], nominal_mm[stretch.row]
    length = float(np.linalg.norm(end - begin))
    direction = (end - begin) / length
    velocity = direction * stretch.speed_mm_s
    part = slice(stretch.first, stretch.last)
    cells = reduce_to_cells(
        time_s[part],
        tracker_mm[part],
        matching.pose.rotation @ velocity,
        run.machine.tracker,
    )
    middle = 0.5 * float(cells.time_s[0] + cells.time_s[-1])
    line_time = cells.time_s - middle
    along = (matching.pose.inverse().apply(cells.tracker_mm) - begin) @ direction
    feed, place = np.polyfit(line_time, along, 1, w=np.sqrt(cells.count)) if len(along) > 1 else (stretch.speed_mm_s, along[0])
    fraction = (place + feed * line_time) / length
    rows = run.commanded.position[stretch.row - 1 : stretch.row + 1]
    position = rows[0] + fraction[:, None] * (rows[1] - rows[0])
    return _Stretch(cells, stretch.row, line, direction * feed, position, line_time)


def _standing(
    run: Run,
    stops: Stops,
    matching: Matching,
    time_s: Float64[np.ndarray, " n"],
    tracker_mm: Float64[np.ndarray, "n 3"],
) -> list[_Stretch]:
    found: list[_Stretch] = []
    for stop, row in zip(matching.stop, matching.waypoint, strict=True):
        first, last = int(stops.first[stop]), int(stops.last[stop])
        time = time_s[first:last]
        inside = first + np.flatnonzero(
            (time > time[0] + _SETTLE_S) & (time < time[-1] - _SETTLE_S)
        )
        if len(inside) < 10:
            continue
        cells = reduce_to_cells(
            time_s[inside], tracker_mm[inside], np.zeros(3), run.machine.tracker
        )
        n = len(cells.time_s)
        position = np.tile(run.commanded.position[row], (n, 1))
        found.append(
            _Stretch(cells, int(row), -1, np.zeros(3), position, np.zeros(n))
        )
    return found


def _joined(
    run: Run, parts: list[_Stretch], matching: Matching, passes: tuple[Pass, ...]
) -> Observations:
    sizes = [len(p.cells.time_s) for p in parts]
    row = np.repeat([p.row for p in parts], sizes)
    velocity = np.repeat(np.array([p.velocity_mm_s for p in parts]), sizes, axis=0)
    speed = np.linalg.norm(velocity, axis=1, keepdims=True)
    targets = run.commanded.target
    names = tuple(targets[r] for r in row) if targets else ()
    at = Conditions(
        run.machine,
        np.concatenate([p.position_mm for p in parts]),
        offsets_mm(run.machine, names, len(row)),
        np.concatenate([p.cells.time_s for p in parts]),
        np.repeat([p.line for p in parts], sizes),
        np.concatenate([p.line_time_s for p in parts]),
        velocity,
        _approach(run.commanded.position)[row],
    )
    square = np.sum([p.cells.scatter_square for p in parts], axis=0)
    freedom = np.sum([p.cells.freedom for p in parts], axis=0)
    count = np.concatenate([p.cells.count for p in parts])
    return Observations(
        at,
        np.concatenate([p.cells.tracker_mm for p in parts]),
        count,
        velocity / np.maximum(speed, 1e-12),
        row,
        np.sqrt(square / np.maximum(freedom, 1.0)),
        matching.pose,
        passes,
        int(count.sum()),
        len(run.tracker),
    )


def _approach(position: Float64[np.ndarray, "w a"]) -> Float64[np.ndarray, "w a"]:
    """Return the sign of each axis' last motion on the way to each row."""
    step = np.sign(np.diff(position, axis=0, prepend=position[:1]))
    last = np.where(step != 0, np.arange(len(step))[:, None], 0)
    np.maximum.accumulate(last, axis=0, out=last)
    return np.take_along_axis(step, last, axis=0)
