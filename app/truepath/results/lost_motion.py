"""Lost motion that a result holds next to its model: by the direction of each axis.

A calibration finds half the difference of both directions with a model of its own, and
holds it as tables; the model of its file is the mean of both. Effects of an extended
model may contain lost motion: that is not counted again.

Across or about an axis (EYX, EAZ, …) the displacement in + direction is the error's arm
times that half, in − direction the opposite.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from truepath.files.earlier.result_file import CalibrationResult, HalfDifference
from truepath.files.units import scale_of
from truepath.kinematics.conditions import Conditions
from truepath.kinematics.effects.error_motion import compute_arm
from truepath.kinematics.machine.machine import position_unit
from truepath.kinematics.machine.symbols import (
    find_unit,
    is_positioning,
    list_error_motions,
)
from truepath.results.error_tables import ErrorTable, compute_half_differences

_SEED = 3  # of its draws, which are independent of those of positioning


def complete_across(result: CalibrationResult) -> CalibrationResult:
    """Add half differences that only the effects of the model have as tables."""
    own = {s: half for s, half in result.halves.items() if is_positioning(s)}
    more = {
        half.symbol: HalfDifference(half.position_mm, half.value, half.uncertainty)
        for half in compute_half_differences(result)
        if not is_positioning(half.symbol) and half.symbol not in result.halves
    }
    return replace(result, halves=own | more | result.halves)


def compute_across_mm(
    result: CalibrationResult, at: Conditions
) -> Float64[np.ndarray, "n 3"]:
    """Displacement of the tool with all axes in + direction; in −, the opposite."""
    moved = np.zeros((len(at), 3))
    for symbol, half in result.halves.items():
        if not is_positioning(symbol):
            moved += _displace(at, symbol, half.position, half.value)
    return moved


def sample_across_mm(
    result: CalibrationResult, at: Conditions, draws: int
) -> Float64[np.ndarray, "2 n 3 d"]:
    """Samples of the error of `compute_across_mm`, in + and in − direction.

    Each error motion is fully correlated along its axis, as it is where it is one
    number for all positions.
    """
    moved = np.zeros((len(at), 3, draws))
    rng = np.random.default_rng(_SEED)
    for symbol, half in result.halves.items():
        if half.sigma is not None and not is_positioning(symbol):
            one = _displace(at, symbol, half.position, half.sigma)
            moved += one[:, :, None] * rng.standard_normal(draws)
    return np.stack([moved, -moved])


def list_half_tables(result: CalibrationResult) -> list[ErrorTable]:
    """In the order of the machine's axes, positioning first; 0 without uncertainty."""
    every = [
        (symbol, axis)
        for axis in result.machine.axes
        for symbol in list_error_motions(axis.name)
        if symbol in result.halves
    ]
    tables: list[ErrorTable] = []
    for symbol, axis in sorted(every, key=lambda one: not is_positioning(one[0])):
        half = result.halves[symbol]
        sigma = np.zeros(len(half.position)) if half.sigma is None else half.sigma
        columns = half.position, half.value, sigma, position_unit(axis)
        tables.append(ErrorTable(symbol, find_unit(symbol), *columns))
    return tables


def _displace(
    at: Conditions,
    symbol: str,
    position: Float64[np.ndarray, " m"],
    value: Float64[np.ndarray, " m"],
) -> Float64[np.ndarray, "n 3"]:
    own = np.interp(at.axis_mm(symbol[2]), position, value)
    own /= scale_of(find_unit(symbol))
    return own[:, None] * compute_arm(symbol, at)


def compute_lost_motion_mm(
    result: CalibrationResult, at: Conditions
) -> Float64[np.ndarray, "n 3"]:
    """Displacement of the target by the tables of half differences.

    Each axis counts by the direction of its own last motion, and 0 where it has not
    moved yet.
    """
    moved = np.zeros((len(at), 3))
    for symbol, half in _list_stated(result):
        moved += _displace_last(at, symbol, half.position, half.value)
    return moved


def list_lost_departures_mm(
    result: CalibrationResult, at: Conditions
) -> Float64[np.ndarray, "n 3 s"]:
    """Displacement by one standard uncertainty of each half difference.

    Each is fully correlated along its axis, as a half width is.
    """
    each: list[Float64[np.ndarray, "n 3"]] = []
    for symbol, half in _list_stated(result):
        sigma = np.zeros(len(half.position)) if half.sigma is None else half.sigma
        each.append(_displace_last(at, symbol, half.position, sigma))
    return np.stack([np.zeros((len(at), 3)), *each], axis=2)


def _list_stated(result: CalibrationResult) -> list[tuple[str, HalfDifference]]:
    effects = result.model.effects
    own = {
        effect.half_difference.symbol for effect in effects if effect.half_difference
    }
    return [(s, half) for s, half in result.halves.items() if s not in own]


def _displace_last(
    at: Conditions,
    symbol: str,
    position: Float64[np.ndarray, " m"],
    value: Float64[np.ndarray, " m"],
) -> Float64[np.ndarray, "n 3"]:
    last = at.approach[:, at.machine.axis_names.index(symbol[2])]
    return last[:, None] * _displace(at, symbol, position, value)
