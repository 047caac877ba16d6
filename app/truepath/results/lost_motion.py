"""Lost motion that a result holds next to its model: by the direction of each axis.

A calibration finds half the difference of both directions with a model of its own, and
holds it as tables; the model of its file is the mean of both. Effects of an extended
model may contain lost motion: that is not counted again.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float64

from truepath.files.earlier.result_file import CalibrationResult, Table
from truepath.files.units import scale_of
from truepath.kinematics.conditions import Conditions
from truepath.kinematics.effects.error_motion import compute_arm
from truepath.kinematics.machine.symbols import find_unit

Sigma = Float64[np.ndarray, " m"]


def compute_lost_motion_mm(
    result: CalibrationResult, at: Conditions
) -> Float64[np.ndarray, "n 3"]:
    """Displacement of the target by the tables of half differences.

    Each axis counts by the direction of its own last motion, and 0 where it has not
    moved yet.
    """
    moved = np.zeros((len(at), 3))
    for symbol, table, _ in _list_stated(result):
        moved += _displace(at, symbol, table)
    return moved


def list_lost_departures_mm(
    result: CalibrationResult, at: Conditions
) -> Float64[np.ndarray, "n 3 s"]:
    """Displacement by one standard uncertainty of each half difference.

    Each is fully correlated along its axis, as a half width is.
    """
    each = [
        _displace(at, symbol, (table[0], sigma))
        for symbol, table, sigma in _list_stated(result)
    ]
    return np.stack([np.zeros((len(at), 3)), *each], axis=2)


def _list_stated(result: CalibrationResult) -> Iterator[tuple[str, Table, Sigma]]:
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


def _displace(at: Conditions, symbol: str, table: Table) -> Float64[np.ndarray, "n 3"]:
    axis = symbol[2]
    value = np.interp(at.axis_mm(axis), *table) / scale_of(find_unit(symbol))
    value = value * at.approach[:, at.machine.axis_names.index(axis)]
    return value[:, None] * compute_arm(symbol, at)
