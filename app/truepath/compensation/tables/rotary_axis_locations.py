"""Actual locations of rotary axes: nominal location and location errors.

XOC, YOC shift the C axis in its local directions, AOC, BOC tilt it about its origin; in
the frame that faces the base, at the zero of the axes between it and the base.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

from truepath.compensation.rotary_tables import (
    RotaryAxisLocation,
)
from truepath.compensation.tables.error_map import ErrorMap
from truepath.kinematics.effects.error_motion import list_axis_locations


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
