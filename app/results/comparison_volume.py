"""The volumetric error that both sides' tables make, and what is between them.

sanders-2023, section 2.3.2 and figure 9: a regular grid over the range that the direct
measurement covers, squareness left out, both sets of tables in one convention.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.files.units import UM_PER_MM, scale_of
from app.kinematics.conditions import make_standstill
from app.kinematics.effects.error_motion import find_arm, reference_position_mm
from app.kinematics.machine import LinearAxis, Machine
from app.results.comparison import ComparedError, Comparison

GRID = 9  # positions an axis


@dataclass(frozen=True, slots=True)
class ComparedVolume:
    """Volumetric errors on a grid, in µm.

    position : (n, axes); rotary axes stand at their zero
    value_um, reference_um : (n, 3) of the errors that both know
    """

    position: Float64[np.ndarray, "n a"]
    value_um: Float64[np.ndarray, "n 3"]
    reference_um: Float64[np.ndarray, "n 3"]

    @property
    def difference_um(self) -> Float64[np.ndarray, "n 3"]:
        """Result less reference."""
        return self.value_um - self.reference_um


def mean_length(error: Float64[np.ndarray, "n 3"]) -> float:
    """Return the mean length of vectors: the paper's mean absolute error."""
    return float(np.linalg.norm(error, axis=1).mean())


def compare_volumes(machine: Machine, comparison: Comparison) -> ComparedVolume | None:
    """Return both volumetric errors, or None if no straight axis was compared."""
    straight = {axis.name for axis in machine.linear_axes}
    errors = [e for e in comparison.errors if e.symbol[2] in straight]
    if not errors:
        return None
    position = _make_grid(machine, errors)
    at = make_standstill(machine, position)
    value, reference = np.zeros((len(position), 3)), np.zeros((len(position), 3))
    for error in errors:
        # µm per µm, or µm per µrad: the arm is in mm per rad.
        arm = find_arm(error.symbol, at) * (UM_PER_MM / scale_of(error.unit))
        where = at.axis_mm(error.symbol[2])
        value += arm * _interpolate(error, where, error.value)
        reference += arm * _interpolate(error, where, error.reference)
    return ComparedVolume(position, value, reference)


def _interpolate(
    error: ComparedError,
    where_mm: Float64[np.ndarray, " n"],
    values: Float64[np.ndarray, " m"],
) -> Float64[np.ndarray, "n 1"]:
    return np.interp(where_mm, error.position_mm, values)[:, None]


def _make_grid(
    machine: Machine, errors: list[ComparedError]
) -> Float64[np.ndarray, "n a"]:
    columns = [
        _choose_positions(axis, [e for e in errors if e.symbol[2] == axis.name])
        if isinstance(axis, LinearAxis)
        else np.array([reference_position_mm(axis)])
        for axis in machine.axes
    ]
    mesh = np.meshgrid(*columns, indexing="ij")
    return np.stack([part.ravel() for part in mesh], axis=1)


def _choose_positions(axis: LinearAxis, errors: list[ComparedError]) -> np.ndarray:
    """Return positions over the range that all errors of an axis have."""
    low = max((float(e.position_mm[0]) for e in errors), default=axis.low)
    high = min((float(e.position_mm[-1]) for e in errors), default=axis.high)
    return np.linspace(low, high, GRID)
