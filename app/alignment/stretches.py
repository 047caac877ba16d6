"""Cells of one pass or one standstill, with what was commanded there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

from app.alignment.observations import Observations, Pass
from app.alignment.reduction import Cells, reduce_to_cells
from app.alignment.segmentation import Stream
from app.alignment.sequence import Matching
from app.alignment.stops import Stops
from app.errors import AlignmentError
from app.kinematics.effects.base import Conditions, standstill
from app.kinematics.machine import Machine
from app.measurement.run import Run
from app.numerics.rigid import RigidTransform

_SETTLE_S = 0.05
_FEWEST_SAMPLES = 10
_CREEP_MM = 0.03  # several times what the air does in a second


@dataclass(frozen=True, slots=True)
class Stretch:
    """Cells of one pass (`line` counts passes) or of one standstill (`line` is −1).

    row : of the commanded path or points; velocity_mm_s : (3,), 0 at a standstill
    position_mm : (n, axes) nominal; line_time_s : (n,) from the middle of the pass
    """

    cells: Cells
    row: int
    line: int
    velocity_mm_s: Float64[np.ndarray, "3"]
    position_mm: Float64[np.ndarray, "n a"]
    line_time_s: Float64[np.ndarray, " n"]


def offsets_mm(
    machine: Machine, targets: Sequence[str], rows: int
) -> Float64[np.ndarray, "n 3"]:
    """Return the offset of the target measured at each commanded row."""
    names = targets or [""] * rows
    return np.array([machine.target(name).offset_mm for name in names], np.float64)


def nominal_places_mm(
    machine: Machine, position: Float64[np.ndarray, "n a"], targets: Sequence[str]
) -> Float64[np.ndarray, "n 3"]:
    """Return where the target of each row should be, where the tracker stands."""
    at = standstill(machine, position, offsets_mm(machine, targets, len(position)))
    aside = on_workpiece(machine, targets, len(position))
    return at.seen_by(machine.tracker.stands_on, aside).point_mm


def on_workpiece(
    machine: Machine, targets: Sequence[str], rows: int
) -> Bool[np.ndarray, " n"]:
    """Tell whether the target measured at each row is on the workpiece."""
    names = targets or [""] * rows
    return np.array([machine.target(name).on == "workpiece" for name in names], bool)


def moving_stretch(
    run: Run,
    line: int,
    each: Pass,
    stream: Stream,
    nominal_mm: Float64[np.ndarray, "w 3"],
) -> Stretch:
    """Return the cells of one pass; their places follow from a constant feed."""
    begin, end = nominal_mm[each.row - 1], nominal_mm[each.row]
    length = float(np.linalg.norm(end - begin))
    direction = (end - begin) / length
    part = slice(each.first, each.last)
    cells = reduce_to_cells(
        stream.time_s[part],
        stream.tracker_mm[part],
        stream.pose.rotation @ (direction * each.speed_mm_s),
        run.machine.tracker,
    )
    line_time = cells.time_s - 0.5 * float(cells.time_s[0] + cells.time_s[-1])
    along = (stream.pose.inverse().apply(cells.tracker_mm) - begin) @ direction
    place, feed = _straight_line(line_time, along, cells.count, each.speed_mm_s)
    fraction = (place + feed * line_time) / length
    rows = run.commanded.position[each.row - 1 : each.row + 1]
    position = rows[0] + fraction[:, None] * (rows[1] - rows[0])
    return Stretch(cells, each.row, line, direction * feed, position, line_time)


def standing_stretches(
    run: Run, stops: Stops, matching: Matching, stream: Stream
) -> list[Stretch]:
    """Return the cells of every matched standstill, settling left out."""
    found: list[Stretch] = []
    for stop, row in zip(matching.stop, matching.waypoint, strict=True):
        first, last = int(stops.first[stop]), int(stops.last[stop])
        time = stream.time_s[first:last]
        settled = (time > time[0] + _SETTLE_S) & (time < time[-1] - _SETTLE_S)
        inside = first + np.flatnonzero(settled)
        if len(inside) < _FEWEST_SAMPLES or _creeps(stream.tracker_mm[inside]):
            continue
        cells = reduce_to_cells(
            stream.time_s[inside],
            stream.tracker_mm[inside],
            np.zeros(3),
            run.machine.tracker,
        )
        n = len(cells.time_s)
        position = np.tile(run.commanded.position[row], (n, 1))
        found.append(Stretch(cells, int(row), -1, np.zeros(3), position, np.zeros(n)))
    if not found:
        raise AlignmentError(
            "the machine never stood still long enough; dwell at least 0.2 s at a point"
        )
    return found


def _creeps(tracker_mm: Float64[np.ndarray, "n 3"]) -> bool:
    """Tell whether a target moves that was too slow to be told from one at rest.

    A target near a rotary axis, or on a table that hardly turns, does so on the way.
    """
    quarters = np.array_split(tracker_mm, 4)
    means = np.array([quarter.mean(axis=0) for quarter in quarters])
    return bool(np.linalg.norm(np.ptp(means, axis=0)) > _CREEP_MM)


def joined(
    run: Run, parts: list[Stretch], pose: RigidTransform, passes: tuple[Pass, ...]
) -> Observations:
    """Return the cells of all stretches as one block."""
    sizes = [len(p.cells.time_s) for p in parts]
    row = np.repeat(np.array([p.row for p in parts]), sizes)
    line = np.repeat(np.array([p.line for p in parts]), sizes)
    velocity = np.repeat(np.array([p.velocity_mm_s for p in parts]), sizes, axis=0)
    speed = np.linalg.norm(velocity, axis=1, keepdims=True)
    targets = run.commanded.target
    names = [targets[p.row] for p in parts for _ in p.cells.time_s] if targets else []
    at = Conditions(
        run.machine,
        np.concatenate([p.position_mm for p in parts]),
        offsets_mm(run.machine, names, len(row)),
        np.concatenate([p.cells.time_s for p in parts]),
        line,
        np.concatenate([p.line_time_s for p in parts]),
        velocity,
        _approach(run.commanded.position)[row],
        run.machine.tracker.stands_on,
        on_workpiece(run.machine, names, len(row)),
    )
    count = np.concatenate([p.cells.count for p in parts])
    return Observations(
        at,
        np.concatenate([p.cells.tracker_mm for p in parts]),
        count,
        velocity / np.maximum(speed, 1e-12),
        row,
        _scatter(parts),
        pose,
        passes,
        int(count.sum()),
        len(run.tracker),
    )


def _straight_line(
    time_s: Float64[np.ndarray, " n"],
    along_mm: Float64[np.ndarray, " n"],
    weight: Float64[np.ndarray, " n"],
    speed_mm_s: float,
) -> tuple[float, float]:
    """Return place at time 0 and speed; the given speed where one cell tells none."""
    if len(time_s) < 2:
        return float(along_mm[0]), speed_mm_s
    place, feed = np.polynomial.polynomial.polyfit(
        time_s, along_mm, 1, w=np.sqrt(weight)
    )
    return float(place), float(feed)


def _scatter(parts: list[Stretch]) -> Float64[np.ndarray, "2"]:
    square = np.sum(np.array([p.cells.scatter_square for p in parts]), axis=0)
    freedom = np.sum(np.array([p.cells.freedom for p in parts]), axis=0)
    return np.sqrt(square / np.maximum(freedom, 1.0))


def _approach(position: Float64[np.ndarray, "w a"]) -> Float64[np.ndarray, "w a"]:
    """Return the sign of each axis' last motion on the way to each row."""
    step = np.sign(np.diff(position, axis=0, prepend=position[:1]))
    last = np.where(step != 0.0, np.arange(len(step))[:, None], 0)
    np.maximum.accumulate(last, axis=0, out=last)
    return np.take_along_axis(step, last, axis=0)
