"""What a recording tells of each cell beside the state of the machine.

Rates, the distance since each axis turned back, where the target is seen from, and
temperatures: effects that depend on these are nothing without them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from app.alignment.observations import Observations, find_lines
from app.kinematics.conditions import RecordedState
from app.motion.configurations import Configurations
from drivers.interfaces.records import Path, TemperatureSamples


def add_surroundings(
    observations: Observations,
    commanded: Path | Configurations,
    temperature: TemperatureSamples | None = None,
    number: int = 0,
) -> Observations:
    """Return the observations, their conditions knowing Run and surroundings.

    number : which of several Runs it is
    """
    recorded = RecordedState(
        _rates(observations),
        observations.count / observations.at.machine.tracker.rate_hz,
        _since_reversal(_in_order(commanded, observations), observations),
        observations.tracker_mm,
        observations.pose.rotation,
        *_temperatures(temperature, observations.at.time_s),
    )
    return replace(
        observations, at=replace(observations.at, run=number, recorded=recorded)
    )


def _in_order(
    commanded: Path | Configurations, observations: Observations
) -> Float64[np.ndarray, "w a"]:
    """Return the commanded positions in the columns of the cells."""
    columns = [
        commanded.axes.index(name) for name in observations.at.machine.axis_names
    ]
    return commanded.position[:, columns]


def _rates(observations: Observations) -> Float64[np.ndarray, "n a"]:
    """Return each axis' rate: a line is driven at a constant one."""
    rates = np.zeros_like(observations.at.position_mm)
    for first, last in find_lines(observations):
        if observations.at.line[first] < 0:
            continue
        span = observations.at.time_s[last - 1] - observations.at.time_s[first]
        if span > 0.0:
            moved = (
                observations.at.position_mm[last - 1]
                - observations.at.position_mm[first]
            )
            rates[first:last] = moved / span
    return rates


def _since_reversal(
    position: Float64[np.ndarray, "w a"], observations: Observations
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
    before = position[np.maximum(observations.row - 1, 0)]
    return travelled[observations.row] + np.abs(observations.at.position_mm - before)


def _temperatures(
    samples: TemperatureSamples | None, time_s: Float64[np.ndarray, " n"]
) -> tuple[tuple[str, ...], Float64[np.ndarray, "n s"] | None]:
    if samples is None or not len(samples.time_s):
        return (), None
    celsius = np.zeros((len(time_s), len(samples.names)))
    for k in range(len(samples.names)):
        celsius[:, k] = np.interp(time_s, samples.time_s, samples.celsius[:, k])
    return samples.names, celsius
