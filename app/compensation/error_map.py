"""The volumetric error of a result at any position, in + and in − direction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.estimation.volumetric_map import VolumetricMap, build_volumetric_map
from app.files.result_file import CalibrationResult
from app.files.units import UM_PER_MM
from app.kinematics.conditions import make_standstill
from app.kinematics.effects.error_motion import reference_position_mm
from app.kinematics.machine import LinearAxis, Machine
from app.kinematics.symbols import DIRECTION, is_turn

HalfTables = dict[str, tuple[Float64[np.ndarray, " m"], Float64[np.ndarray, " m"]]]
"""Positions and half differences, mm, by axis."""


@dataclass(frozen=True, slots=True)
class ErrorMap:
    """A result, its map without rigid motion, and its backlash.

    half_tables : half the difference of + and − direction in the positioning of each
        axis that has one
    """

    result: CalibrationResult
    volumetric_map: VolumetricMap
    half_tables: HalfTables

    @property
    def machine(self) -> Machine:
        """The machine of the result."""
        return self.result.machine

    @property
    def axes(self) -> tuple[LinearAxis, ...]:
        """The axes that tables are written for."""
        return self.machine.linear_axes

    def error_mm(
        self,
        position_mm: Float64[np.ndarray, "n a"],
        direction: float = 0.0,
    ) -> Float64[np.ndarray, "n 3"]:
        """Return δ = actual − nominal.

        direction : 1 or −1 of all axes, 0 for the mean
        """
        error = self.volumetric_map.error_mm(
            make_standstill(self.machine, position_mm), self.result.theta
        )
        for column, axis in enumerate(self.axes):
            half = direction * self.half_difference_mm(
                axis.name, position_mm[:, column]
            )
            error[:, DIRECTION[axis.name]] += half
        return error

    def half_difference_mm(
        self, axis: str, at_mm: Float64[np.ndarray, " n"]
    ) -> Float64[np.ndarray, " n"]:
        """Return half the difference of both directions in an axis' positioning."""
        if axis not in self.half_tables:
            return np.zeros(len(at_mm))
        return np.interp(at_mm, *self.half_tables[axis])

    def rotation_rad(
        self, axis: str, at_mm: Float64[np.ndarray, " n"]
    ) -> Float64[np.ndarray, "n 3"]:
        """Return ω of an axis, 0 where the result has no angular error motion."""
        omega = np.zeros((len(at_mm), 3))
        model = self.result.model
        for motion in model.error_motions:
            if motion.symbol[2] == axis and is_turn(motion.symbol):
                part = model.slices[motion.name]
                value = motion.rows(at_mm) @ self.result.theta[part]
                omega[:, DIRECTION[motion.symbol[1]]] = value
        return omega

    def list_pairs(self) -> list[tuple[str, str]]:
        """Return the axis pairs of the model's effects, the guide first."""
        effects = self.result.model.effects
        return [effect.axis_pair for effect in effects if effect.axis_pair]

    def pair_error_mm(
        self, position_mm: Float64[np.ndarray, "n a"], axis: str, by: str
    ) -> Float64[np.ndarray, "n 3"]:
        """Return the error at the tool point by the effects of a pair of axes."""
        at = make_standstill(self.machine, position_mm)
        model, theta = self.result.model, self.result.theta
        total = np.zeros((len(position_mm), 3))
        for effect in model.effects:
            if effect.axis_pair == (axis, by):
                total += effect.displacement_mm(at, theta[model.slices[effect.name]])
        return total

    def move_axis(
        self,
        axis: LinearAxis,
        at_mm: Float64[np.ndarray, " n"],
        others_mm: Float64[np.ndarray, " a"],
    ) -> Float64[np.ndarray, "n a"]:
        """Return positions of all axes where one axis moves alone."""
        place = np.tile(others_mm, (len(at_mm), 1))
        place[:, self.machine.axis_names.index(axis.name)] = at_mm
        return place

    @property
    def reference_mm(self) -> Float64[np.ndarray, " a"]:
        """Reference position of every axis, where error motions are 0."""
        return np.array([reference_position_mm(axis) for axis in self.machine.axes])

    @property
    def middle_mm(self) -> Float64[np.ndarray, " a"]:
        """Middle of the travel; rotary axes at their zero."""
        middle = self.reference_mm
        for column, axis in enumerate(self.machine.axes):
            if isinstance(axis, LinearAxis):
                middle[column] = 0.5 * (axis.low + axis.high)
        return middle


def map_errors(result: CalibrationResult) -> ErrorMap:
    """Return the error map of a result."""
    half_tables = {
        axis: (position_mm, value_um / UM_PER_MM)
        for axis, (position_mm, value_um) in result.half_difference_um.items()
    }
    return ErrorMap(result, build_volumetric_map(result.model), half_tables)
