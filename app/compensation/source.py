"""The result's volumetric error at any position, going up the axes or down."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.estimation.volumetric_map import VolumetricMap, build_volumetric_map
from app.files.result_file import CalibrationResult
from app.files.units import UM_PER_MM
from app.kinematics.conditions import standstill
from app.kinematics.effects.error_motion import reference_position_mm
from app.kinematics.machine import LinearAxis, Machine
from app.kinematics.symbols import DIRECTION, is_turn

Half = dict[str, tuple[Float64[np.ndarray, " m"], Float64[np.ndarray, " m"]]]


@dataclass(frozen=True, slots=True)
class Source:
    """A result, its map without the rigid motion of the volume, and its backlash.

    half : half difference of both directions of each axis' own positioning, as
        (position mm, value mm), by axis; none where direction plays no part
    """

    result: CalibrationResult
    found: VolumetricMap
    half: Half

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

        direction : 1 where all axes came up, −1 where they came down, 0 for the mean
        """
        error = self.found.error_mm(
            standstill(self.machine, position_mm), self.result.theta
        )
        for column, axis in enumerate(self.axes):
            half = direction * self.half_mm(axis.name, position_mm[:, column])
            error[:, DIRECTION[axis.name]] += half
        return error

    def half_mm(
        self, axis: str, at_mm: Float64[np.ndarray, " n"]
    ) -> Float64[np.ndarray, " n"]:
        """Return half the difference of both directions of an axis' positioning."""
        if axis not in self.half:
            return np.zeros(len(at_mm))
        return np.interp(at_mm, *self.half[axis])

    def turn_rad(
        self, axis: str, at_mm: Float64[np.ndarray, " n"]
    ) -> Float64[np.ndarray, "n 3"]:
        """Return ω of an axis: the turns that the result tells, else 0."""
        omega = np.zeros((len(at_mm), 3))
        model = self.result.model
        for motion in model.error_motions:
            if motion.symbol[2] == axis and is_turn(motion.symbol):
                part = model.slices[motion.name]
                value = motion.rows(at_mm) @ self.result.theta[part]
                omega[:, DIRECTION[motion.symbol[1]]] = value
        return omega

    def pairs(self) -> list[tuple[str, str]]:
        """Return the pairs of axes that the model has effects of, a guide first."""
        effects = self.result.model.effects
        return [effect.axis_pair for effect in effects if effect.axis_pair]

    def bent_mm(
        self, position_mm: Float64[np.ndarray, "n a"], axis: str, by: str
    ) -> Float64[np.ndarray, "n 3"]:
        """Return what the effects of a pair of axes do to the tool point."""
        at = standstill(self.machine, position_mm)
        model, theta = self.result.model, self.result.theta
        total = np.zeros((len(position_mm), 3))
        for effect in model.effects:
            if effect.axis_pair == (axis, by):
                total += effect.displacement_mm(at, theta[model.slices[effect.name]])
        return total

    def middle_mm(self) -> Float64[np.ndarray, " a"]:
        """Return the middle of the travel; rotary axes at their zero."""
        return np.array(
            [
                0.5 * (axis.min_mm + axis.max_mm)
                if isinstance(axis, LinearAxis)
                else reference_position_mm(axis)
                for axis in self.machine.axes
            ]
        )


def source_of(result: CalibrationResult) -> Source:
    """Return what a result says."""
    half = {
        axis: (position_mm, value_um / UM_PER_MM)
        for axis, (position_mm, value_um) in result.half_difference_um.items()
    }
    return Source(result, build_volumetric_map(result.model), half)
