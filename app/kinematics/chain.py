"""Lever arms of a serial chain: what a turn of one axis moves."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from app.kinematics.machine import Machine
from app.kinematics.symbols import LINEAR


def lever_mm(
    machine: Machine,
    axis: str,
    position_mm: Float64[np.ndarray, "n a"],
    offset_mm: Float64[np.ndarray, "n 3"],
) -> Float64[np.ndarray, "n 3"]:
    """Return L_i(q): the target's offset plus the positions of all later axes."""
    lever = offset_mm.copy()
    order, columns = machine.order, machine.axis_names
    for later in order[order.index(axis) + 1 :]:
        lever[:, LINEAR.index(later)] += position_mm[:, columns.index(later)]
    return lever


def nominal_point_mm(
    machine: Machine,
    position_mm: Float64[np.ndarray, "n a"],
    offset_mm: Float64[np.ndarray, "n 3"],
) -> Float64[np.ndarray, "n 3"]:
    """Return the nominal target point in the workpiece frame, q + offset."""
    point = offset_mm.copy()
    for column, axis in enumerate(machine.axis_names):
        point[:, LINEAR.index(axis)] += position_mm[:, column]
    return point
