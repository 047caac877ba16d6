"""Correction by a controller that knows the chain and its error motions."""

from __future__ import annotations

from collections.abc import Callable, Collection

import numpy as np
from jaxtyping import Float64

from truepath.compensation.format import Correction
from truepath.kinematics.machine.machine import Machine
from truepath.kinematics.machine.symbols import LINEAR

FindMotion = Callable[
    [str, Float64[np.ndarray, "n a"], float], Float64[np.ndarray, "n 6"]
]
"""E (mm) and ω (rad) of an axis at positions of all axes in direction 1 or −1."""


def correct_by_motions(
    machine: Machine, axes: Collection[str], find_motion: FindMotion
) -> Correction:
    """Minus the error of the chain from the motions of some axes.

    Squareness is in E, the target's offset too, so that the lever arms of ω are the
    positions of the axes nearer to the tool.
    """

    def correction(
        position_mm: Float64[np.ndarray, "n a"], direction: float
    ) -> Float64[np.ndarray, "n 3"]:
        added = np.zeros((len(position_mm), 3))
        lever = np.zeros((len(position_mm), 3))
        # From the tool to the workpiece: later axes are the lever of earlier ones.
        for axis in reversed([name for name in machine.order if name in LINEAR]):
            if axis in axes:
                motion = find_motion(axis, position_mm, direction)
                added -= motion[:, :3] + np.cross(motion[:, 3:], lever)
            lever[:, LINEAR.index(axis)] += position_mm[
                :, machine.axis_names.index(axis)
            ]
        return added

    return correction


def interpolate_rows(
    table: Float64[np.ndarray, "m 7"], at_mm: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, "n 6"]:
    """Motions linear between rows (position, E, ω); end values hold."""
    columns = [np.interp(at_mm, table[:, 0], table[:, k]) for k in range(1, 7)]
    return np.stack(columns, axis=1)
