"""Positioning of rotary axes as tables, and their actual locations.

ECC is a turn of the tool relative to the workpiece. So a head turns too far by it; a
table, which turns the workpiece, too little. The tables hold the rotation of the axis
itself beyond its command.

Location errors XOC, YOC shift the C axis in its local directions, AOC, BOC tilt it
about its origin; in the frame that faces the base, at the zero of the axes between it
and the base.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from truepath.compensation.format import (
    RotaryAxisLocation,
    RotaryTable,
)
from truepath.compensation.tables.error_map import ErrorMap
from truepath.kinematics.effects.error_motion import (
    list_axis_locations,
    reference_position_mm,
)
from truepath.kinematics.machine.machine import RotaryAxis
from truepath.kinematics.machine.symbols import TURNS, list_error_motions

SPACING_DEG = 2.5


def tabulate_rotary(
    errors: ErrorMap, most_points: int, others: Collection[str] = ()
) -> tuple[RotaryTable, ...]:
    """A table for each rotary axis whose positioning the result has.

    others : axes that get a table in any case, of what the result has of them
    """
    return tuple(
        _tabulate(errors, axis, most_points)
        for axis in errors.machine.rotary_axes
        if has_positioning(errors, axis) or axis.name in others
    )


def find_sense(errors: ErrorMap, axis: RotaryAxis) -> float:
    """1 where the axis turns the tool, −1 where it turns the workpiece."""
    return -1.0 if axis.name in errors.machine.workpiece_side else 1.0


def has_positioning(errors: ErrorMap, axis: RotaryAxis) -> bool:
    """Whether the result has the positioning of the axis."""
    own = f"E{axis.name}{axis.name}"
    motions = errors.result.model.identifiable_motions
    return any(one.symbol == own for one in motions)


def compute_positioning_rad(
    errors: ErrorMap, axis: RotaryAxis, at_deg: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, " n"]:
    """ECC of a C axis at positions; beyond the measured range that at its ends."""
    at_deg = clip_to_measured(errors, axis, at_deg)
    return errors.rotation_rad(axis.name, at_deg)[:, TURNS.index(axis.name)]


def clip_to_measured(
    errors: ErrorMap, axis: RotaryAxis, at_deg: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, " n"]:
    """Positions, clipped to the measured range."""
    measured = errors.result.measured.get(axis.name)
    if measured is None or axis.turns_fully:
        return at_deg
    return np.clip(at_deg, *measured)


def _tabulate(errors: ErrorMap, axis: RotaryAxis, most_points: int) -> RotaryTable:
    high = axis.low + 360.0 if axis.turns_fully else axis.high
    wanted = math.ceil((high - axis.low) / SPACING_DEG - 1e-9) + 1
    at_deg = np.linspace(axis.low, high, int(np.clip(wanted, 2, most_points)))
    zero = np.array([reference_position_mm(axis)])
    value, at_zero = (
        compute_positioning_rad(errors, axis, at) for at in (at_deg, zero)
    )
    error_deg = find_sense(errors, axis) * np.degrees(value - at_zero)
    half_rad = errors.half_difference(axis.name, clip_to_measured(errors, axis, at_deg))
    half_deg = find_sense(errors, axis) * np.degrees(half_rad)
    motions = _find_motions(errors, axis, at_deg)
    if axis.turns_fully:
        for column in (error_deg, motions, half_deg):
            column[-1] = column[0]
    return RotaryTable(axis, at_deg, error_deg, motions, half_deg)


def _find_motions(
    errors: ErrorMap, axis: RotaryAxis, at_deg: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, "n 6"]:
    at_deg = clip_to_measured(errors, axis, at_deg)
    symbols, model = list_error_motions(axis.name), errors.result.model
    motions = np.zeros((len(at_deg), len(symbols)))
    for one in model.identifiable_motions:
        if one.symbol in symbols:
            value = one.rows(at_deg) @ errors.result.theta[model.slices[one.name]]
            motions[:, symbols.index(one.symbol)] = value
    return motions


def find_locations(errors: ErrorMap) -> tuple[RotaryAxisLocation, ...]:
    """Location of each rotary axis, as far as the result has it."""
    theta, slices = errors.result.theta, errors.result.model.slices
    untold = errors.result.model.confounded
    return tuple(
        RotaryAxisLocation(
            axis,
            {
                one.symbol: float(theta[slices[one.symbol]][0])
                for one in list_axis_locations(axis)
                if one.symbol in slices
            },
            frozenset(untold),
        )
        for axis in errors.machine.rotary_axes
    )


def exclude_locations(errors: ErrorMap, symbols: Collection[str]) -> ErrorMap:
    """Errors of a machine without these locations of rotary axes.

    Where the zero of a rotary axis is outside its travel, tables of linear axes are
    made at another angle, at which a wrong location moves the tool as well.
    """
    theta, slices = errors.result.theta.copy(), errors.result.model.slices
    for symbol in symbols:
        if symbol in slices:
            theta[slices[symbol]] = 0.0
    return replace(errors, result=replace(errors.result, theta=theta))
