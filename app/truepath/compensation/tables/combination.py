"""Tables that replace those active during the measurement.

If the control adds c, a measurement finds the remaining error d. Tables hold the error,
which is minus what is added: the replacement of the active ones is d − c. E and ω of
each axis in c are found by moving it alone, and one other axis.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from truepath.compensation.active_files import ActiveFiles
from truepath.compensation.format import AxisTable, CompensationTables
from truepath.compensation.rotary_tables import (
    RotaryAddition,
    RotaryAxisLocation,
    RotaryTable,
)
from truepath.compensation.tables.error_map import ErrorMap
from truepath.kinematics.effects.error_motion import reference_position_mm

# What the angle k does at lever l: displacement o, and its sign.
_TURNS = ((0, 1, 2), (1, 2, 0), (2, 0, 1))


def combine_tables(
    content: CompensationTables, errors: ErrorMap, active: ActiveFiles
) -> CompensationTables:
    """The tables plus the active ones, at the same positions."""
    located = active.kind.read_locations(active.texts, errors.machine)
    added = active.kind.read_rotary(active.texts, errors.machine)
    return replace(
        content,
        tables=tuple(_combine_axis(one, errors, active) for one in content.tables),
        rotary=tuple(_combine_rotary(one, added) for one in content.rotary),
        places=tuple(_combine_place(one, located) for one in content.places),
    )


def _combine_axis(table: AxisTable, errors: ErrorMap, active: ActiveFiles) -> AxisTable:
    at_mm, own, zero = table.position_mm, table.own, table.reference

    def find_error(
        rest: Float64[np.ndarray, " a"], side: float, **moved_mm: float
    ) -> Float64[np.ndarray, "n 3"]:
        place = errors.move_axis(table.axis, at_mm, rest)
        for name, value_mm in moved_mm.items():
            place[:, errors.machine.axis_names.index(name)] = value_mm
        return -active.correction(place, side)

    up, down = (find_error(errors.middle_mm, side) for side in (1.0, -1.0))
    mean, half = 0.5 * (up + down), np.zeros_like(up)
    half[:, own] = 0.5 * (up - down)[:, own]
    forward, backward = mean + half, mean - half

    order, rest = errors.machine.order, errors.reference_mm
    lever, omega = np.zeros(3), np.zeros_like(up)
    for other in errors.axes:
        if order.index(other.name) > order.index(table.axis.name):
            out, ends = errors.axes.index(other), (other.low, other.high)
            lever[out] = rest[errors.machine.axis_names.index(other.name)]
            low, high = (find_error(rest, 1.0, **{other.name: end}) for end in ends)
            slope = (high - low) / (other.high - other.low)
            _take_larger(omega, slope - slope[zero], out)
    still = 0.5 * (find_error(rest, 1.0) + find_error(rest, -1.0))
    return replace(
        table,
        forward_mm=table.forward_mm + forward - forward[zero],
        backward_mm=table.backward_mm + backward - forward[zero],
        translation_mm=table.translation_mm
        + (still - still[zero])
        - np.cross(omega, lever),
        rotation_rad=table.rotation_rad + omega,
    )


def _take_larger(
    omega: Float64[np.ndarray, "n 3"], slope: Float64[np.ndarray, "n 3"], lever: int
) -> None:
    """Angles from the slope along a lever.

    A control that lacks a table does half of what an angle would: the larger half.
    """
    for out, k, other in _TURNS:
        for shown, sign, along in ((out, 1.0, other), (other, -1.0, out)):
            if along == lever and slope[:, shown].std() > omega[:, k].std():
                omega[:, k] = sign * slope[:, shown]


def _combine_rotary(
    table: RotaryTable, added: Mapping[str, RotaryAddition]
) -> RotaryTable:
    axis, at_deg = table.axis, table.position_deg
    if axis.name not in added:
        return table
    up, down = (added[axis.name].read(at_deg, side) for side in (1.0, -1.0))
    zero = added[axis.name].read(np.array([reference_position_mm(axis)]))
    return replace(
        table,
        error_deg=table.error_deg - (0.5 * (up + down) - zero),
        half_deg=table.half_deg - 0.5 * (up - down),
    )


def _combine_place(
    place: RotaryAxisLocation, located: Mapping[str, float]
) -> RotaryAxisLocation:
    own = {s: v for s, v in located.items() if s[2] == place.axis.name}
    known = {**dict.fromkeys(own, 0.0), **place.location}
    return replace(place, location={s: v + own.get(s, 0.0) for s, v in known.items()})
