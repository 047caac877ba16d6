"""Lost motion across or about an axis: error motions that depend on the direction.

A result holds half the difference of both directions by symbol (EYX, EAZ, …), over the
positions of the axis. The displacement in + direction is the error's arm times it, in −
direction the opposite.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from truepath.files.earlier.result_file import CalibrationResult, Table
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
    return value[:, None] * compute_arm(symbol, at)
