"""Where rotary axes really are: their nominal place and their location errors.

XOC, YOC shift the C axis in its local directions, AOC, BOC tilt it about its origin;
in the frame that faces the base, at the zero of the axes between it and the base.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from jaxtyping import Float64

from truepath.app.compensation.error_map import ErrorMap
from truepath.app.compensation.rotary_tables import (
    AxisPlace,
)
from truepath.app.files.units import UM_PER_MM
from truepath.app.kinematics.conditions import Conditions, make_standstill
from truepath.app.kinematics.effects.location_error import list_axis_locations
from truepath.app.kinematics.machine import RotaryAxis


def find_places(errors: ErrorMap) -> tuple[AxisPlace, ...]:
    """Return the place of each rotary axis; what the result does not know is 0."""
    theta, slices = errors.result.theta, errors.result.model.slices
    return tuple(
        AxisPlace(
            axis,
            {
                one.symbol: float(theta[slices[one.symbol]][0])
                for one in list_axis_locations(axis)
                if one.symbol in slices
            },
        )
        for axis in errors.machine.rotary_axes
    )


def describe_locations(
    errors: ErrorMap,
    axis: RotaryAxis,
    position: Float64[np.ndarray, "n a"],
    read: Mapping[str, float],
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield what the location of an axis does at the tool, before and with the files.

    position : over the travel of all axes; read : location by symbol (mm, rad), as the
    control has it from the files
    """
    (place,) = (one for one in find_places(errors) if one.axis.name == axis.name)
    if not place.location:
        return
    at = make_standstill(errors.machine, position)
    left = {k: v - read.get(k, 0.0) for k, v in place.location.items()}
    yield (
        "location_at_tool_um",
        {
            "before": UM_PER_MM * _rms_mm(axis, at, place.location),
            "after": UM_PER_MM * _rms_mm(axis, at, left),
        },
    )


def _rms_mm(axis: RotaryAxis, at: Conditions, value: Mapping[str, float]) -> float:
    moved = np.zeros((len(at), 3))
    for one in list_axis_locations(axis):
        if one.symbol in value:
            moved += one.jacobian(at)[:, :, 0] * value[one.symbol]
    return float(np.linalg.norm(moved) / np.sqrt(len(at)))
