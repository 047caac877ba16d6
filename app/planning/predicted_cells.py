"""A measurement before it is made: the cells that a path or points would give.

Nothing is drawn at random and nothing moves. The cells stand where the machine would
be, as often and for as long as feed and dwell have it, and where the tracker would see
them; what they tell follows from that alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from app.alignment.cell_blocks import approach_signs
from app.alignment.observations import Observations, add_surroundings
from app.errors import PlanningError
from app.estimation.noise import NoiseModel
from app.kinematics.conditions import Conditions, make_standstill, observe_targets
from app.kinematics.machine import LinearAxis, Machine
from app.motion.configurations import Commanded, Configurations
from app.motion.motion_times import ACCELERATION_MM_S2, Drive, Stops, row_times_s
from app.numerics.rigid import RigidTransform
from drivers.interfaces.records import Path

# Usual of trackers in a shop; what a Run shows is estimated once there is one.
EXPECTED_NOISE = NoiseModel((1.0, 1.0), (0.2, 0.2), 1.0, 2e-4)
_CELL_MM, _CELL_S = 16.0, 0.25
_MOST_CELLS = 4000  # then cells are longer
_STEADY = 0.1  # of a line, at least: a short one is driven below its feed
_AHEAD = 1e-4  # of a line, to see where the target is going
_POINT_TO_POINT_S = 2.0  # usual time of a move between standstill points


@dataclass(frozen=True, slots=True)
class _Stretch:
    """One line or dwell: shares of the way to its row, and the times of its cells.

    rate : of the share, a second; 0 for a dwell
    """

    row: int
    share: Float64[np.ndarray, " n"]
    time_s: Float64[np.ndarray, " n"]
    cell_s: float
    rate: float = 0.0


def predict_cells(
    machine: Machine,
    commanded: Commanded,
    station_mm: Float64[np.ndarray, "3"],
    *,
    cell_mm: float = _CELL_MM,
) -> Observations:
    """Return the cells of a measurement with the tracker at a place.

    They know their surroundings, temperatures left out.

    station_mm : in the frame that the tracker stands on (workpiece or base)
    cell_mm : length of cells along lines, at least

    Raises PlanningError if nothing moves and nothing dwells.
    """
    is_path = isinstance(commanded, Path)
    parts = list(_lines(commanded, cell_mm) if is_path else _dwells(commanded))
    if not parts:
        raise PlanningError(
            "no line has a length and no point a dwell; nothing would be measured"
        )
    at = _conditions(machine, commanded, parts)
    speed = np.linalg.norm(at.velocity_mm_s, axis=1, keepdims=True)
    seconds = np.concatenate([np.full(len(p.share), p.cell_s) for p in parts])
    count = np.maximum(machine.tracker.rate_hz * seconds, 1.0)
    seen = Observations(
        at,
        at.point_mm - station_mm,
        count,
        at.velocity_mm_s / np.maximum(speed, 1e-12),
        np.concatenate([np.full(len(p.share), p.row) for p in parts]),
        np.ones(2),
        RigidTransform(np.eye(3), -station_mm),
        (),
        int(count.sum()),
        int(count.sum()),
    )
    return add_surroundings(seen, commanded)


def _lines(path: Path, cell_mm: float) -> Iterator[_Stretch]:
    """Yield the part of each line that is driven at constant feed."""
    row_s = row_times_s(path)
    begin_s = np.cumsum(row_s) - row_s
    legs = Stops(path.position, path.feed_mm_min).legs
    length = Drive.of(path.axes, 0.0).length(legs)
    speed = path.feed_mm_min[1:] / 60.0
    steady = np.maximum(length - speed**2 / ACCELERATION_MM_S2, _STEADY * length)
    cell = np.maximum(cell_mm, steady.clip(0.0).sum() / _MOST_CELLS)
    for k in np.flatnonzero(steady > 0.0):
        cells = max(1, round(float(steady[k] / min(cell, max(speed[k], cell)))))
        place = (np.arange(cells) + 0.5) / cells * steady[k]
        share = (place + 0.5 * (length[k] - steady[k])) / length[k]
        time_s = begin_s[k + 1] + place / speed[k] + speed[k] / ACCELERATION_MM_S2
        seconds = float(steady[k] / speed[k] / cells)
        yield _Stretch(int(k) + 1, share, time_s, seconds, float(speed[k] / length[k]))


def _dwells(points: Configurations) -> Iterator[_Stretch]:
    begin_s = np.cumsum(points.dwell_s + _POINT_TO_POINT_S)
    cell = max(_CELL_S, float(points.dwell_s.sum()) / _MOST_CELLS)
    for k in np.flatnonzero(points.dwell_s > 0.0):
        cells = max(1, round(float(points.dwell_s[k]) / cell))
        seconds = float(points.dwell_s[k]) / cells
        time_s = begin_s[k] + (np.arange(cells) + 0.5) * seconds
        yield _Stretch(int(k), np.ones(cells), time_s, seconds)


def _conditions(
    machine: Machine, commanded: Commanded, parts: list[_Stretch]
) -> Conditions:
    sizes = [len(p.share) for p in parts]
    row = np.repeat([p.row for p in parts], sizes)
    rate = np.repeat([p.rate for p in parts], sizes)
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
    velocity = find_slopes_mm(at, step) * rate[:, None]
    goes = np.linalg.norm(velocity, axis=1) > 0.0
    line = np.where(goes, row, -1)
    lag = np.where(goes, time_s - middle, 0.0)
    return replace(
        at,
        time_s=time_s,
        line=line,
        line_time_s=lag,
        velocity_mm_s=velocity,
        approach=approach_signs(position)[row],
    )


def find_slopes_mm(
    at: Conditions, step: Float64[np.ndarray, "n a"]
) -> Float64[np.ndarray, "n 3"]:
    """Return how the target's place changes with the share of a step of the axes."""
    behind, ahead = (
        replace(at, position_mm=at.position_mm + sign * _AHEAD * step).point_mm
        for sign in (-1.0, 1.0)
    )
    return (ahead - behind) / (2.0 * _AHEAD)


def assume_stations_mm(machine: Machine) -> Float64[np.ndarray, "s 3"]:
    """Return four usual places of a tracker: a metre off each side, at middle height.

    For when nobody has said where it will stand.
    """
    straight = [isinstance(axis, LinearAxis) for axis in machine.axes]
    travel = np.array([(axis.low, axis.high) for axis in machine.axes]).T
    reach_mm = make_standstill(machine, np.where(straight, travel, 0.0)).point_mm
    low, high = reach_mm.min(axis=0), reach_mm.max(axis=0)
    middle = (low + high) / 2.0
    stands = np.tile(middle, (4, 1))
    stands[0, 0], stands[1, 0] = low[0] - 1000.0, high[0] + 1000.0
    stands[2, 1], stands[3, 1] = low[1] - 1000.0, high[1] + 1000.0
    return stands
