"""Cells of all passes and standstills as one block of observations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float64, Int64

from truepath.alignment.observations.cell_blocks import CellBlock
from truepath.alignment.observations.observations import Observations, Pass
from truepath.alignment.stream.left_out import LeftOut, gather
from truepath.alignment.stream.seating import Seats, refer_to_first
from truepath.files.bundle.run import Run
from truepath.kinematics.conditions import Conditions
from truepath.motion.configurations import Commanded
from truepath.numerics.rigid import RigidTransform
from truepath_drivers.interfaces.arcs import trace
from truepath_drivers.interfaces.records import Path


def join_blocks(
    run: Run,
    parts: list[CellBlock],
    pose: RigidTransform,
    passes: tuple[Pass, ...],
    seats: Seats,
    left_out: list[LeftOut] | None = None,
) -> Observations:
    """Concatenates the blocks, which are in order of time.

    seats : targets that are far off their stated positions, and their shifts
    left_out : exclusions outside the blocks, in addition to those of each block
    """
    said = [*(left_out or []), *(each for p in parts for each in p.left_out)]
    own = np.repeat(np.arange(len(parts)), [len(p.cells.time_s) for p in parts])
    velocity = np.concatenate([p.velocity_mm_s for p in parts])
    speed = np.linalg.norm(velocity, axis=1, keepdims=True)
    at = _collect_conditions(run, parts, own, seats)
    row = np.array([p.row for p in parts])[own]
    count = np.concatenate([p.cells.count for p in parts])
    seen = Observations(
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
        gather(said, at.time_s, row),
        np.array([p.is_ramp for p in parts])[own],
    )
    if run.mode != "standstill" or len(parts) == len(seen):
        return seen
    # Samples of a place are off together: it is one cell, however long it took. Where
    # it was knocked, its block has only one side of that.
    return seen.join(np.flatnonzero(np.diff(own, prepend=-1)))


def _collect_conditions(
    run: Run, parts: list[CellBlock], own: Int64[np.ndarray, " n"], seats: Seats
) -> Conditions:
    machine = run.machine
    row = np.array([p.row for p in parts])[own]
    velocity = np.concatenate([p.velocity_mm_s for p in parts])
    mean_speed = np.where(
        np.array([p.is_ramp for p in parts])[own],
        np.linalg.norm(velocity, axis=1),
        np.array([p.line_speed_mm_s for p in parts])[own],
    )
    names = run.commanded.target or ("",) * len(run.commanded)
    targets = [machine.target(names[int(r)]) for r in row]
    at = Conditions(
        machine,
        np.concatenate([p.position_mm for p in parts]),
        np.array([target.offset_mm for target in targets], np.float64),
        np.concatenate([p.cells.time_s for p in parts]),
        np.array([p.line for p in parts])[own],
        np.concatenate([p.line_time_s for p in parts]),
        velocity,
        _find_approach(run.commanded)[row],
        machine.tracker.stands_on,
        np.array([target.on == "workpiece" for target in targets], bool),
        mean_speed if machine.rotary_axes else None,
        acceleration=_join_accelerations(parts),
    )
    seats = refer_to_first(machine, seats)
    if not seats:
        return at
    shifts = [seats.get(target.name, np.zeros(3)) for target in targets]
    return replace(at, seat_mm=np.array(shifts, np.float64))


def _join_accelerations(parts: list[CellBlock]) -> Float64[np.ndarray, "n a"] | None:
    if not any(p.is_ramp for p in parts):
        return None
    return np.concatenate(
        [
            np.zeros_like(p.position_mm) if p.acceleration is None else p.acceleration
            for p in parts
        ]
    )


def _scatter(parts: list[CellBlock]) -> Float64[np.ndarray, "2"]:
    square = np.sum(np.array([p.cells.scatter_square for p in parts]), axis=0)
    freedom = np.sum(np.array([p.cells.freedom for p in parts]), axis=0)
    return np.where(freedom > 0.0, np.sqrt(square / np.maximum(freedom, 1.0)), np.nan)


def _find_approach(commanded: Commanded) -> Float64[np.ndarray, "w a"]:
    if not isinstance(commanded, Path):
        return approach_signs(commanded.position)
    position, owner = trace(commanded)
    last = np.searchsorted(owner, np.arange(len(commanded)), "right") - 1
    return approach_signs(position)[last]


def approach_signs(
    position: Float64[np.ndarray, "w a"],
) -> Float64[np.ndarray, "w a"]:
    """Sign of each axis' last motion on the way to each row; 0 before its first."""
    step = np.sign(np.diff(position, axis=0, prepend=position[:1]))
    last = np.where(step != 0.0, np.arange(len(step))[:, None], 0)
    np.maximum.accumulate(last, axis=0, out=last)
    return np.take_along_axis(step, last, axis=0)
