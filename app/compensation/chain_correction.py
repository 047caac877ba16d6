"""What a controller adds that composes the errors of straight and rotary axes.

Errors of an axis are of the tool relative to the workpiece, those of a rotary axis in
its own directions about its origin. The straight axes take away what they do at the
tool.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float64

from truepath.app.compensation.format import Correction
from truepath.app.compensation.motion_correction import FindMotion
from truepath.app.kinematics.conditions import Conditions, make_standstill
from truepath.app.kinematics.effects.location_error import list_axis_locations
from truepath.app.kinematics.machine import (
    Machine,
    RotaryAxis,
    find_local_directions,
)


def correct_by_chain(
    machine: Machine,
    tool_mm: Float64[np.ndarray, "3"],
    find_motion: FindMotion,
    location: Mapping[str, float],
) -> Correction:
    """Return minus the error that the chain makes of all motions and locations.

    tool_mm : the tip where all axes are at zero; location : by symbol, mm and rad
    """

    def correction(
        position_mm: Float64[np.ndarray, "n a"], direction: float
    ) -> Float64[np.ndarray, "n 3"]:
        offset = np.tile(tool_mm, (len(position_mm), 1))
        at = make_standstill(machine, position_mm, offset)
        error = np.zeros((len(at), 3))
        for axis in machine.axes:
            motion = find_motion(axis.name, position_mm, direction)
            local = np.eye(3)
            if isinstance(axis, RotaryAxis):
                local = find_local_directions(axis)
                for one in list_axis_locations(axis):
                    if value := location.get(one.symbol):
                        error += one.jacobian(at)[:, :, 0] * value
            lever = at.chain.lever(axis.name)
            error += lever.displace(motion[:, :3] @ local.T, is_turn=False)
            error += lever.displace(motion[:, 3:] @ local.T, is_turn=True)
        return -np.linalg.solve(_find_steps(at), error[:, :, None])[:, :, 0]

    return correction


def _find_steps(at: Conditions) -> Float64[np.ndarray, "n 3 3"]:
    """Return what a millimetre of each straight axis moves the tool by, as columns."""
    columns: list[Float64[np.ndarray, "n 3"]] = []
    for name in "XYZ":
        moved = at.position_mm.copy()
        moved[:, at.machine.axis_names.index(name)] += 1.0
        there = make_standstill(at.machine, moved, at.offset_mm)
        columns.append(there.chain.point_mm - at.chain.point_mm)
    return np.stack(columns, axis=2)
