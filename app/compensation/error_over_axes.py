"""The volumetric error where all axes move, rotary ones too, before and with files."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float64

from truepath.app.compensation.error_map import ErrorMap
from truepath.app.compensation.format import (
    Correction,
)
from truepath.app.compensation.remaining_error import remove_rigid_motion
from truepath.app.compensation.rotary import sample_positions
from truepath.app.compensation.rotary_tables import (
    RotaryAddition,
)
from truepath.app.files.units import UM_PER_MM
from truepath.app.kinematics.conditions import make_standstill
from truepath.app.kinematics.effects.location_error import list_axis_locations

_SIDES = (1.0, -1.0)


def measure_over_axes(
    errors: ErrorMap,
    correction: Correction,
    added: Mapping[str, RotaryAddition],
    located: Mapping[str, float],
) -> dict[str, Any] | None:
    """Return the mean length of the map, µm; None for a machine of straight axes.

    correction, added, located : what the control adds to straight and to rotary axes,
        and what it knows of their places beside that (mm, rad by symbol)
    """
    if not errors.machine.rotary_axes:
        return None
    position = sample_positions(errors)
    before: list[float] = []
    after: list[float] = []
    for side in _SIDES:
        error = errors.error_mm(position, side)
        moved = _move(errors, position, correction(position, side), added, located)
        before.append(_find_mean_um(errors, position, error))
        after.append(_find_mean_um(errors, position, error + moved))
    return {
        "before": float(np.mean(before)),
        "after": float(np.mean(after)),
        "on": f"mean length of the map over {len(position)} positions that fill the "
        "travel of all axes evenly, up and down, without rigid motion of the workpiece",
    }


def _move(
    errors: ErrorMap,
    position: Float64[np.ndarray, "n a"],
    straight_mm: Float64[np.ndarray, "n 3"],
    added: Mapping[str, RotaryAddition],
    located: Mapping[str, float],
) -> Float64[np.ndarray, "n 3"]:
    """Return how the tool moves by what the control adds."""
    machine, sent = errors.machine, position.copy()
    for column, name in enumerate(machine.axis_names):
        if name in added:
            sent[:, column] += added[name].read(position[:, column])
    sent[:, [machine.axis_names.index(name) for name in "XYZ"]] += straight_mm
    at = make_standstill(machine, position)
    moved = make_standstill(machine, sent).chain.point_mm - at.chain.point_mm
    for axis in machine.rotary_axes:
        for one in list_axis_locations(axis):
            if value := located.get(one.symbol):
                moved -= one.jacobian(at)[:, :, 0] * value
    return moved


def _find_mean_um(
    errors: ErrorMap,
    position: Float64[np.ndarray, "n a"],
    error_mm: Float64[np.ndarray, "n 3"],
) -> float:
    point_mm = make_standstill(errors.machine, position).chain.point_mm
    left = remove_rigid_motion(point_mm, error_mm)
    return UM_PER_MM * float(np.linalg.norm(left, axis=1).mean())
