"""What a recording tells of each cell beside the state of the machine.

Rates, the distance since each axis turned back, where the target is seen from, and
temperatures: effects that depend on these are nothing without them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float64, Int64

from app.alignment.observations import Observations
from app.kinematics.conditions import RecordedState
from app.motion.configurations import Configurations
from drivers.interfaces.records import Path, TemperatureSamples


def with_surroundings(
    seen: Observations,
    commanded: Path | Configurations,
    temperature: TemperatureSamples | None = None,
    number: int = 0,
) -> Observations:
    """Return the observations, their conditions knowing Run and surroundings.

    number : which of several Runs it is
    """
    recorded = RecordedState(
        _rates(seen),
        seen.count / seen.at.machine.tracker.rate_hz,
        _since_reversal(_in_order(commanded, seen), seen),
        seen.tracker_mm,
        seen.pose.rotation,
        *_temperatures(temperature, seen.at.time_s),
    )
    return replace(seen, at=replace(seen.at, run=number, recorded=recorded))


def _in_order(
    commanded: Path | Configurations, seen: Observations
) -> Float64[np.ndarray, "w a"]:
    """Return the commanded positions in the columns of the cells."""
    columns = [commanded.axes.index(name) for name in seen.at.machine.axis_names]
    return commanded.position[:, columns]


def _rates(seen: Observations) -> Float64[np.ndarray, "n a"]:
    """Return each axis' rate: a line is driven at a constant one."""
    rates = np.zeros_like(seen.at.position_mm)
    begin, end = _stretches(seen)
    for first, last in zip(begin, end, strict=True):
        if seen.at.line[first] < 0:
            continue
        span = seen.at.time_s[last - 1] - seen.at.time_s[first]
        if span > 0.0:
            moved = seen.at.position_mm[last - 1] - seen.at.position_mm[first]
            rates[first:last] = moved / span
    return rates


def _stretches(
    seen: Observations,
) -> tuple[Int64[np.ndarray, " s"], Int64[np.ndarray, " s"]]:
    """Return first cell and one past the last of each line or standstill."""
    breaks = (np.diff(seen.at.line) != 0) | (np.diff(seen.row) != 0)
    begin = np.flatnonzero(np.concatenate([[True], breaks]))
    return begin, np.append(begin[1:], len(seen))


def _since_reversal(
    position: Float64[np.ndarray, "w a"], seen: Observations
) -> Float64[np.ndarray, "n a"]:
    """Return how far each axis has gone since it last turned back."""
    step = np.diff(position, axis=0, prepend=position[:1])
    travelled = np.full_like(position, np.inf)  # when the move to a row begins
    sign, gone = np.zeros(position.shape[1]), np.full(position.shape[1], np.inf)
    for row, move in enumerate(step):
        now = np.sign(move)
        gone = np.where((now != 0) & (sign != 0) & (now != sign), 0.0, gone)
        travelled[row] = gone
        gone = gone + np.abs(move)
        sign = np.where(now != 0, now, sign)
    before = position[np.maximum(seen.row - 1, 0)]
    return travelled[seen.row] + np.abs(seen.at.position_mm - before)


def _temperatures(
    told: TemperatureSamples | None, time_s: Float64[np.ndarray, " n"]
) -> tuple[tuple[str, ...], Float64[np.ndarray, "n s"] | None]:
    if told is None or not len(told.time_s):
        return (), None
    celsius = np.zeros((len(time_s), len(told.names)))
    for k in range(len(told.names)):
        celsius[:, k] = np.interp(time_s, told.time_s, told.celsius[:, k])
    return told.names, celsius
