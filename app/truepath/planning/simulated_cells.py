"""The cells that a path or points would give, before the measurement.

Nothing is random and nothing moves. The cells are at the machine's positions, as many
and as long as feed and dwell give, and where the tracker would see them; their
information follows from that alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from truepath.alignment.observations.cell_blocks import STANDSTILL_SETTLE_S
from truepath.alignment.observations.observations import Observations
from truepath.alignment.observations.segmentation import RAMP_SETTLE_S
from truepath.alignment.observations.surroundings import (
    add_surroundings,
    approach_signs,
)
from truepath.errors import PlanningError
from truepath.estimation.problem.noise import NoiseModel
from truepath.kinematics.conditions import Conditions, make_standstill, observe_targets
from truepath.kinematics.machine.machine import LinearAxis, Machine
from truepath.motion.configurations import Commanded, Configurations
from truepath.motion.motion_times import Drive, Stops, row_times_s
from truepath.numerics.rigid import RigidTransform, build_rotation
from truepath_drivers.interfaces.records import Path

# Typical of trackers in a shop; a Run's own noise is estimated later.
EXPECTED_NOISE = NoiseModel((1.0, 1.0), (0.2, 0.2, 0.2), 1.0, 2e-4)
_CELL_MM, _CELL_S = 16.0, 0.25
_MOST_CELLS = 4000  # then cells are longer
_AHEAD = 1e-4  # of a line, to see where the target is going
_POINT_TO_POINT_S = 2.0  # typical time of a move between standstill points


@dataclass(frozen=True, slots=True)
class _Stretch:
    """Part of a line, or a dwell: shares of the line, and times of its cells.

    rate : of the share, per second; 0 for a dwell
    change : of the rate, per second, on a ramp; None elsewhere
    """

    row: int
    share: Float64[np.ndarray, " n"]
    time_s: Float64[np.ndarray, " n"]
    cell_s: float
    rate: Float64[np.ndarray, " n"]
    change: Float64[np.ndarray, " n"] | None = None

    @property
    def is_ramp(self) -> bool:
        return self.change is not None


def predict_cells(
    machine: Machine,
    commanded: Commanded,
    station_mm: Float64[np.ndarray, "3"],
    *,
    cell_mm: float = _CELL_MM,
    turn_rad: float = 0.0,
) -> Observations:
    """The cells of a measurement with the tracker at a station.

    With their surroundings, without temperatures.

    station_mm : in the frame that the tracker is mounted on (workpiece or base)
    cell_mm : length of cells along lines, at least
    turn_rad : of the tracker about its standing axis, from where it faces the machine
    Raises PlanningError if nothing moves and nothing dwells.
    """
    is_path = isinstance(commanded, Path)
    parts = list(_lines(machine, commanded, cell_mm) if is_path else _dwells(commanded))
    if not parts:
        raise PlanningError(
            "no line has a length and no point a dwell; nothing would be measured"
        )
    at = _conditions(machine, commanded, parts)
    speed = np.linalg.norm(at.velocity_mm_s, axis=1, keepdims=True)
    seconds = np.concatenate([np.full(len(p.share), p.cell_s) for p in parts])
    count = np.maximum(machine.tracker.rate_hz * seconds, 1.0)
    x, y, _ = at.point_mm.mean(axis=0) - station_mm
    rotation = build_rotation(np.array([0.0, 0.0, turn_rad - np.arctan2(y, x)]))
    pose = RigidTransform(rotation, -rotation @ station_mm)
    seen = Observations(
        at,
        pose.apply(at.point_mm),
        count,
        at.velocity_mm_s / np.maximum(speed, 1e-12),
        np.concatenate([np.full(len(p.share), p.row) for p in parts]),
        np.ones(2),
        pose,
        (),
        int(count.sum()),
        int(count.sum()),
        ramp=np.concatenate([np.full(len(p.share), p.is_ramp) for p in parts]),
    )
    return add_surroundings(seen, commanded)


def _lines(machine: Machine, path: Path, cell_mm: float) -> Iterator[_Stretch]:
    row_s = row_times_s(path, limits=machine.motion)
    end_s = np.cumsum(row_s)
    drive = Drive.of(path.axes, 0.0, machine.motion)
    legs = Stops(path.position, path.feed_mm_min).legs
    length, speed = np.maximum(drive.length(legs), 1e-9), drive.peak_mm_s(legs)
    ramp_s, (lost, steady_s) = drive.ramp_s(speed), drive.steady(legs)
    turns = drive.turns(legs)
    cell = np.maximum(cell_mm, length.sum() / _MOST_CELLS)
    yield from _dwell(0, path.dwell_s[0], end_s[0])
    for k in range(len(legs)):
        row, begin_s = k + 1, end_s[k]
        if path.arc and path.arc[row] is not None:  # of no use to an estimate
            yield from _dwell(row, path.dwell_s[row], end_s[row])
            continue
        moving_s = row_s[row] - path.dwell_s[row]
        span_s = 0.5 * (moving_s - steady_s[k])
        ramp = None  # on a curve it has no information
        if not turns[k]:
            ramp = _ramp(row, lost[k], span_s, ramp_s[k], cell / length[k])
        if ramp is not None:
            yield replace(ramp, time_s=begin_s + ramp.time_s)
        if steady_s[k] > 0.0:
            rate = (1.0 - 2.0 * lost[k]) / steady_s[k]
            cells = _count(steady_s[k], rate * length[k] / cell)
            place = (np.arange(cells) + 0.5) / cells
            yield _Stretch(
                row,
                lost[k] + place * (1.0 - 2.0 * lost[k]),
                begin_s + span_s + place * steady_s[k],
                float(steady_s[k] / cells),
                np.full(cells, rate),
            )
        if ramp is not None and ramp.change is not None:
            yield replace(
                ramp,
                share=1.0 - ramp.share[::-1],
                time_s=begin_s + moving_s - ramp.time_s[::-1],
                rate=ramp.rate[::-1],
                change=-ramp.change[::-1],
            )
        yield from _dwell(row, path.dwell_s[row], end_s[row])


def _ramp(
    row: int, lost: float, span_s: float, ramp_s: float, cell_share: float
) -> _Stretch | None:
    """First stretch of a line: constant acceleration, then settling. lost : share of
    the line that it takes; span_s : its time, ramp_s of it on the ramp
    """
    used_s = span_s - RAMP_SETTLE_S
    if used_s <= 0.0:
        return None
    cells = _count(used_s, lost / used_s / cell_share)
    time_s = RAMP_SETTLE_S + (np.arange(cells) + 0.5) / cells * used_s
    ramp_s = min(ramp_s, span_s)
    rate = lost / (span_s - 0.5 * ramp_s)  # at the end of the ramp
    on_ramp_s = np.minimum(time_s, ramp_s)
    share = rate * (0.5 * on_ramp_s**2 / ramp_s + time_s - on_ramp_s)
    seconds = used_s / cells
    change = np.where(time_s < ramp_s, rate / ramp_s, 0.0)
    return _Stretch(row, share, time_s, seconds, rate * on_ramp_s / ramp_s, change)


def _dwell(row: int, dwell_s: float, end_s: float) -> Iterator[_Stretch]:
    span_s = dwell_s - 2.0 * STANDSTILL_SETTLE_S
    if span_s <= 0.0:
        return
    cells = _count(span_s, 0.0)
    place = (np.arange(cells) + 0.5) / cells
    time_s = end_s - dwell_s + STANDSTILL_SETTLE_S + place * span_s
    yield _Stretch(row, np.ones(cells), time_s, span_s / cells, np.zeros(cells))


def _count(span_s: float, cells_per_s: float) -> int:
    """No cell lasts longer than a second."""
    return max(1, round(float(span_s * max(cells_per_s, 1.0))))


def _dwells(points: Configurations) -> Iterator[_Stretch]:
    begin_s = np.cumsum(points.dwell_s + _POINT_TO_POINT_S)
    cell = max(_CELL_S, float(points.dwell_s.sum()) / _MOST_CELLS)
    for k in np.flatnonzero(points.dwell_s > 0.0):
        cells = max(1, round(float(points.dwell_s[k]) / cell))
        seconds = float(points.dwell_s[k]) / cells
        time_s = begin_s[k] + (np.arange(cells) + 0.5) * seconds
        yield _Stretch(int(k), np.ones(cells), time_s, seconds, np.zeros(cells))


def _conditions(
    machine: Machine, commanded: Commanded, parts: list[_Stretch]
) -> Conditions:
    sizes = [len(p.share) for p in parts]
    row = np.repeat([p.row for p in parts], sizes)
    rate = np.concatenate([p.rate for p in parts])
    share = np.concatenate([p.share for p in parts])
    time_s = np.concatenate([p.time_s for p in parts])
    middle = np.concatenate([np.full(len(p.share), p.time_s.mean()) for p in parts])
    order = [commanded.axes.index(name) for name in machine.axis_names]
    position = commanded.position[:, order]
    begin = position[np.where(rate > 0.0, row - 1, row)]
    step = position[row] - begin
    targets = [machine.target(name) for name in commanded.target or ("",)]
    if commanded.target:
        targets = [targets[int(r)] for r in row]
    at = observe_targets(machine, begin + share[:, None] * step, targets)
    velocity = compute_slopes_mm(at, step) * rate[:, None]
    change = np.concatenate(
        [np.zeros(len(p.share)) if p.change is None else p.change for p in parts]
    )
    goes = np.linalg.norm(velocity, axis=1) > 0.0
    line = np.where(goes, row, -1)
    timed = goes & ~np.repeat([p.is_ramp for p in parts], sizes)
    lag = np.where(timed, time_s - middle, 0.0)
    return replace(
        at,
        time_s=time_s,
        line=line,
        line_time_s=lag,
        velocity_mm_s=velocity,
        approach=approach_signs(position)[row],
        acceleration=change[:, None] * step,
    )


def compute_slopes_mm(
    at: Conditions, step: Float64[np.ndarray, "n a"]
) -> Float64[np.ndarray, "n 3"]:
    """Derivative of the target's position by the share of a step of the axes."""
    behind, ahead = (
        replace(at, position_mm=at.position_mm + sign * _AHEAD * step).point_mm
        for sign in (-1.0, 1.0)
    )
    return (ahead - behind) / (2.0 * _AHEAD)


def assume_stations_mm(machine: Machine) -> Float64[np.ndarray, "s 3"]:
    """Four typical tracker stations: a metre off each side, at middle height.

    Used when no station is given.
    """
    straight = [isinstance(axis, LinearAxis) for axis in machine.axes]
    ends = np.where(straight, machine.travel, 0.0)
    reach_mm = make_standstill(machine, ends).point_mm
    low, high = reach_mm.min(axis=0), reach_mm.max(axis=0)
    middle = (low + high) / 2.0
    stations = np.tile(middle, (4, 1))
    stations[0, 0], stations[1, 0] = low[0] - 1000.0, high[0] + 1000.0
    stations[2, 1], stations[3, 1] = low[1] - 1000.0, high[1] + 1000.0
    return stations
