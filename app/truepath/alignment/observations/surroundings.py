"""Cells of a Run as one block of observations, with the recorded conditions of each.

Conditions are rates, distances since a reversal, temperatures and locks of the beam.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float64, Int64

from truepath.alignment.observations.cell_blocks import CellBlock
from truepath.alignment.observations.observations import Observations, Pass
from truepath.alignment.stream.left_out import LeftOut, gather
from truepath.alignment.stream.seating import Seats, refer_to_first
from truepath.files.bundle.run import Run
from truepath.files.environment import interpolate, is_usable
from truepath.kinematics.conditions import Conditions, RecordedState
from truepath.kinematics.effects.instrument import name_set_up
from truepath.motion.configurations import Commanded
from truepath.numerics.rigid import RigidTransform
from truepath_drivers.interfaces.arcs import trace
from truepath_drivers.interfaces.records import Path, TemperatureSamples


def concatenate_blocks(
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
    excluded = [*(left_out or []), *(each for p in parts for each in p.left_out)]
    own = np.repeat(np.arange(len(parts)), [len(p.cells.time_s) for p in parts])
    velocity = np.concatenate([p.velocity_mm_s for p in parts])
    speed = np.linalg.norm(velocity, axis=1, keepdims=True)
    at = _collect_conditions(run, parts, own, seats)
    row = np.array([p.row for p in parts])[own]
    count = np.concatenate([p.cells.count for p in parts])
    square = np.sum(np.array([p.cells.scatter_square for p in parts]), axis=0)
    freedom = np.sum(np.array([p.cells.freedom for p in parts]), axis=0)
    seen = Observations(
        at,
        np.concatenate([p.cells.tracker_mm for p in parts]),
        count,
        velocity / np.maximum(speed, 1e-12),
        row,
        np.where(freedom > 0.0, np.sqrt(square / np.maximum(freedom, 1.0)), np.nan),
        pose,
        passes,
        int(count.sum()),
        len(run.tracker),
        gather(excluded, at.time_s, row),
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
    acceleration = np.concatenate(
        [
            np.zeros_like(p.position_mm) if p.acceleration is None else p.acceleration
            for p in parts
        ]
    )
    at = Conditions(
        machine,
        np.concatenate([p.position_mm for p in parts]),
        np.array([target.offset_mm for target in targets], np.float64),
        np.concatenate([p.cells.time_s for p in parts]),
        np.array([p.line for p in parts])[own],
        np.concatenate([p.line_time_s for p in parts]),
        velocity,
        _compute_approach(run.commanded)[row],
        machine.tracker.stands_on,
        np.array([target.on == "workpiece" for target in targets], bool),
        mean_speed if machine.rotary_axes else None,
        acceleration=acceleration if any(p.is_ramp for p in parts) else None,
    )
    seats = refer_to_first(machine, seats)
    if not seats:
        return at
    shifts = [seats.get(target.name, np.zeros(3)) for target in targets]
    return replace(at, seat_mm=np.array(shifts, np.float64))


def _compute_approach(commanded: Commanded) -> Float64[np.ndarray, "w a"]:
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


def add_surroundings(
    observations: Observations,
    commanded: Commanded,
    temperature: TemperatureSamples | None = None,
    number: int = 0,
    locks_s: Sequence[float] = (),
) -> Observations:
    """Adds the recorded conditions and the Run's number.

    number : which of several Runs it is
    locks_s : times when the beam was found again after it was lost
    """
    tracker = observations.at.machine.tracker
    recorded = RecordedState(
        _compute_rates(observations),
        observations.count / tracker.rate_hz,
        _measure_since_reversal(commanded, observations),
        observations.tracker_mm,
        observations.pose.rotation,
        *_interpolate_temperatures(temperature, observations.at.time_s),
        np.searchsorted(np.array(locks_s), observations.at.time_s, side="right"),
        name_set_up(observations.pose.rotation, tracker.face),
    )
    return replace(
        observations, at=replace(observations.at, run=number, recorded=recorded)
    )


def _compute_rates(observations: Observations) -> Float64[np.ndarray, "n a"]:
    rates = np.zeros_like(observations.at.position_mm)
    for first, last in observations.lines:
        if observations.at.line[first] < 0:
            continue
        cells = np.arange(first, last)
        steady = cells[~observations.is_ramp[first:last]]
        a, b = (steady if len(steady) > 1 else cells)[[0, -1]]
        span = observations.at.time_s[b] - observations.at.time_s[a]
        if span > 0.0:
            moved = observations.at.position_mm[b] - observations.at.position_mm[a]
            speed = np.linalg.norm(observations.at.velocity_mm_s[cells], axis=1)
            mean = speed[steady - first].mean() if len(steady) > 1 else speed.mean()
            pace = np.where(observations.is_ramp[cells], speed / mean, 1.0)
            rates[cells] = pace[:, None] * moved / span
    return rates


def _measure_since_reversal(
    commanded: Commanded, observations: Observations
) -> Float64[np.ndarray, "n a"]:
    columns = [
        commanded.axes.index(name) for name in observations.at.machine.axis_names
    ]
    position, owner = commanded.position, np.arange(len(commanded))
    if isinstance(commanded, Path):
        position, owner = trace(commanded)
    position = position[:, columns]
    step = np.diff(position, axis=0, prepend=position[:1])
    travelled = np.full_like(position, np.inf)  # when the move to a row begins
    sign, gone = np.zeros(position.shape[1]), np.full(position.shape[1], np.inf)
    for row, move in enumerate(step):
        now = np.sign(move)
        gone = np.where((now != 0) & (sign != 0) & (now != sign), 0.0, gone)
        travelled[row] = gone
        gone = gone + np.abs(move)
        sign = np.where(now != 0, now, sign)
    first = np.searchsorted(owner, observations.row)  # of its motion
    before = position[np.maximum(first - 1, 0)]
    return travelled[first] + np.abs(observations.at.position_mm - before)


def _interpolate_temperatures(
    samples: TemperatureSamples | None, time_s: Float64[np.ndarray, " n"]
) -> tuple[tuple[str, ...], Float64[np.ndarray, "n s"] | None]:
    """Sensors with a long gap are excluded."""
    if samples is None or not len(samples.time_s) or not len(time_s):
        return (), None
    ends = float(time_s.min()), float(time_s.max())
    used = {
        name: interpolate(samples.time_s, column, time_s)
        for name, column in zip(samples.names, samples.celsius.T, strict=True)
        if is_usable(samples.time_s, column, *ends)
    }
    return (tuple(used), np.stack(list(used.values()), axis=1)) if used else ((), None)
