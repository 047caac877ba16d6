"""Lost motion that a result holds next to its model: by the direction of each axis.

A calibration finds half the difference of both directions with a model of its own, and
holds it as tables; the model of its file is the mean of both. Effects of an extended
model may contain lost motion: that is not counted again.

Across or about an axis (EYX, EAZ, …) the displacement in + direction is the error's arm
times that half, in − direction the opposite.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from truepath.files.earlier.result_file import CalibrationResult, Table
from truepath.files.units import scale_of
from truepath.kinematics.conditions import Conditions
from truepath.kinematics.effects.error_motion import find_arm
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
    more = [
        half
        for half in compute_half_differences(result)
        if not is_positioning(half.symbol) and half.symbol not in result.half_across
    ]
    tables = {half.symbol: (half.position_mm, half.value) for half in more}
    sigmas = {half.symbol: half.uncertainty for half in more}
    return replace(
        result,
        half_across=tables | result.half_across,
        half_across_u=sigmas | result.half_across_u,
    )


def remove_across(result: CalibrationResult, symbol: str) -> CalibrationResult:
    """Without the half difference of one error motion."""
    kept = {name: one for name, one in result.half_across.items() if name != symbol}
    sigmas = {name: one for name, one in result.half_across_u.items() if name != symbol}
    return replace(result, half_across=kept, half_across_u=sigmas)


def compute_across_mm(
    result: CalibrationResult, at: Conditions
) -> Float64[np.ndarray, "n 3"]:
    """Displacement of the tool with all axes in + direction; in −, the opposite."""
    moved = np.zeros((len(at), 3))
    for symbol, table in result.half_across.items():
        moved += _displace(at, symbol, table)
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
    for symbol, sigma in result.half_across_u.items():
        position, _ = result.half_across[symbol]
        one = _displace(at, symbol, (position, sigma))
        moved += one[:, :, None] * rng.standard_normal(draws)
    return np.stack([moved, -moved])


def list_across_tables(result: CalibrationResult) -> Iterator[ErrorTable]:
    """In the order of the machine's axes; 0 where there is no uncertainty."""
    for axis in result.machine.axes:
        for symbol in list_error_motions(axis.name):
            if symbol in result.half_across:
                at, value = result.half_across[symbol]
                sigma = result.half_across_u.get(symbol, np.zeros(len(at)))
                unit = position_unit(axis)
                yield ErrorTable(symbol, find_unit(symbol), at, value, sigma, unit)


def _displace(at: Conditions, symbol: str, table: Table) -> Float64[np.ndarray, "n 3"]:
    value = np.interp(at.axis_mm(symbol[2]), *table) / scale_of(find_unit(symbol))
    return value[:, None] * find_arm(symbol, at)


def compute_lost_motion_mm(
    result: CalibrationResult, at: Conditions
) -> Float64[np.ndarray, "n 3"]:
    """Displacement of the target by the tables of half differences.

    Each axis counts by the direction of its own last motion, and 0 where it has not
    moved yet.
    """
    moved = np.zeros((len(at), 3))
    for symbol, table, _ in _list_stated(result):
        moved += _displace_last(at, symbol, table)
    return moved


def list_lost_departures_mm(
    result: CalibrationResult, at: Conditions
) -> Float64[np.ndarray, "n 3 s"]:
    """Displacement by one standard uncertainty of each half difference.

    Each is fully correlated along its axis, as a half width is.
    """
    each = [
        _displace_last(at, symbol, (table[0], sigma))
        for symbol, table, sigma in _list_stated(result)
    ]
    return np.stack([np.zeros((len(at), 3)), *each], axis=2)


def _list_stated(
    result: CalibrationResult,
) -> Iterator[tuple[str, Table, np.ndarray]]:
    effects = result.model.effects
    own = {
        effect.half_difference.symbol for effect in effects if effect.half_difference
    }
    for prefixed, tables, sigmas in (
        (True, result.half_difference_um, result.half_difference_u_um),
        (True, result.half_turn_urad, result.half_turn_u_urad),
        (False, result.half_across, result.half_across_u),
    ):
        for name, table in tables.items():
            symbol = f"E{name}{name}" if prefixed else name
            if symbol not in own:
                yield symbol, table, sigmas.get(name, np.zeros(len(table[0])))


def _displace_last(
    at: Conditions, symbol: str, table: Table
) -> Float64[np.ndarray, "n 3"]:
    last = at.approach[:, at.machine.axis_names.index(symbol[2])]
    return last[:, None] * _displace(at, symbol, table)
