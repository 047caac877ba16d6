"""Conditions of each cell from the recording: rates, reversals, temperatures, locks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from truepath.alignment.observations.observations import Observations
from truepath.files.environment import interpolate, is_usable
from truepath.kinematics.conditions import RecordedState
from truepath.kinematics.effects.instrument import name_set_up
from truepath.motion.configurations import Configurations
from truepath_drivers.interfaces.arcs import trace
from truepath_drivers.interfaces.records import Path, TemperatureSamples


def add_surroundings(
    observations: Observations,
    commanded: Path | Configurations,
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
        _rates(observations),
        observations.count / tracker.rate_hz,
        _since_reversal(commanded, observations),
        observations.tracker_mm,
        observations.pose.rotation,
        *_temperatures(temperature, observations.at.time_s),
        np.searchsorted(np.array(locks_s), observations.at.time_s, side="right"),
        name_set_up(observations.pose.rotation, tracker.face),
    )
    return replace(
        observations, at=replace(observations.at, run=number, recorded=recorded)
    )


def _rates(observations: Observations) -> Float64[np.ndarray, "n a"]:
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


def _since_reversal(
    commanded: Path | Configurations, observations: Observations
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


def _temperatures(
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
