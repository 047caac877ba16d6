"""The volumetric error of a result at any position, and as tables of its axes.

Where an axis was not measured, splines continue beyond the last measured position with
an uncertainty that grows fast: their value there is no measurement. A table holds the
value of the last measured position, or fades from there to 0 at the end of the travel.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from jaxtyping import Float64

from truepath.compensation.format import AxisTable, PairTable
from truepath.errors import BadInput
from truepath.files.earlier.result_file import CalibrationResult
from truepath.files.units import scale_of
from truepath.kinematics.conditions import Conditions, make_standstill
from truepath.kinematics.effects.error_motion import compute_arm, reference_position_mm
from truepath.kinematics.machine.machine import Axis, LinearAxis, Machine
from truepath.kinematics.machine.symbols import DIRECTION, LINEAR, find_unit, is_turn
from truepath.kinematics.volumetric_map import VolumetricMap, build_volumetric_map
from truepath.results.lost_motion import complete_across, compute_across_mm

_LEAST_MM = 1e-3  # a shorter range is due to rounding
_FEWEST, _FINEST = 2, 11  # positions of the second axis of a pair


class Unmeasured(StrEnum):
    """Treatment of the part of a travel that was not measured."""

    HOLD = "hold"
    FADE = "fade"
    REFUSE = "refuse"

    @property
    def words(self) -> str:
        """Text for people."""
        if self is Unmeasured.FADE:
            return "fades to 0 at the end of the travel"
        return "holds the value of the last measured position"


@dataclass(frozen=True, slots=True)
class MeasuredRange:
    """The measured range of an axis, and the content of its table beyond.

    choice : None for the model's extrapolation
    is_stated : whether the result says where it was measured; if not, the range is the
        travel
    """

    axis: LinearAxis
    low: float
    high: float
    choice: Unmeasured | None
    is_stated: bool = True

    @property
    def missing(self) -> tuple[tuple[float, float], ...]:
        """Parts of the travel that were not measured."""
        ends = (self.axis.low, self.low), (self.high, self.axis.high)
        return tuple((a, b) for a, b in ends if b - a > _LEAST_MM)

    def clip(self, at_mm: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
        """Positions whose errors a table holds at its own positions."""
        return at_mm if self.choice is None else np.clip(at_mm, self.low, self.high)

    def weigh(self, at_mm: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
        """Weight of the error there: 1, or less where it fades."""
        weight = np.ones(len(at_mm))
        if self.choice is not Unmeasured.FADE:
            return weight
        for begin, end in self.missing:
            measured, far = (begin, end) if begin == self.high else (end, begin)
            share = (at_mm - far) / (measured - far)
            weight = np.minimum(weight, np.clip(share, 0.0, 1.0))
        return weight

    @property
    def is_fully_measured(self) -> bool:
        """Whether the whole travel was measured according to the result."""
        return self.is_stated and not self.missing

    def describe(self) -> str:
        """Text about the unmeasured range, in plain ASCII."""
        if not self.is_stated:
            return (
                f"{self.axis.name}: the result does not state where it was measured: "
                "its table has what it says over the whole travel"
            )
        parts = " and ".join(f"{a:g} to {b:g}" for a, b in self.missing)
        choice = self.choice or Unmeasured.HOLD
        return f"{self.axis.name} not measured from {parts} mm: {choice.words}"


def compute_measured_ranges(
    machine: Machine,
    measured: Mapping[str, tuple[float, float]],
    choice: Unmeasured | None,
) -> dict[str, MeasuredRange]:
    """Measured range of each linear axis; the whole travel where none is stated.

    Raises BadInput if a part was not measured, or may not have been, and the choice is
    to refuse.
    """
    ranges = {
        axis.name: MeasuredRange(
            axis,
            *measured.get(axis.name, (axis.low, axis.high)),
            choice,
            axis.name in measured,
        )
        for axis in machine.linear_axes
    }
    if choice is Unmeasured.REFUSE:
        said = [one.describe() for one in ranges.values() if not one.is_fully_measured]
        if said:
            text = "; ".join(text.rpartition(":")[0] for text in said)
            raise BadInput(f"{text}; measure there, or hold or fade the values")
    return ranges


@dataclass(frozen=True, slots=True)
class ErrorMap:
    """A result, and its volumetric map without rigid motion."""

    result: CalibrationResult
    volumetric_map: VolumetricMap

    @property
    def machine(self) -> Machine:
        """The machine of the result."""
        return self.result.machine

    @property
    def axes(self) -> tuple[LinearAxis, ...]:
        """The linear axes, for which tables are written."""
        return self.machine.linear_axes

    def error_mm(
        self,
        position_mm: Float64[np.ndarray, "n a"],
        direction: float = 0.0,
    ) -> Float64[np.ndarray, "n 3"]:
        """δ = actual − nominal; of a machine of linear axes without its rigid motion.

        With rotary axes it is in the gauge of the error motions, in which their
        locations are given: a turn of all linear axes would change these.

        direction : 1 or −1 of all axes, 0 for the mean
        """
        at = make_standstill(self.machine, position_mm)
        if self.machine.rotary_axes:
            error = self.volumetric_map.displacement_mm(at, self.result.theta)
        else:
            error = self.volumetric_map.error_mm(at, self.result.theta)
        error += direction * compute_across_mm(self.result, at)
        for column, axis in enumerate(self.axes):
            half = self.half_difference(axis.name, position_mm[:, column])
            error += direction * half[:, None] * find_own_arm(axis, at)
        return error

    def half_difference(
        self, axis: str, at: Float64[np.ndarray, " n"]
    ) -> Float64[np.ndarray, " n"]:
        """Half the difference of both directions in positioning; 0 where unknown.

        at : mm or deg; the half is in mm or rad
        """
        half = self.result.halves.get(symbol := f"E{axis}{axis}")
        if half is None:
            return np.zeros(len(at))
        return np.interp(at, half.position, half.value / scale_of(find_unit(symbol)))

    def half_difference_sigma(
        self, axis: str, at: Float64[np.ndarray, " n"]
    ) -> Float64[np.ndarray, " n"]:
        """Standard uncertainty of that half; 0 where none is stated."""
        half = self.result.halves.get(symbol := f"E{axis}{axis}")
        if half is None or half.sigma is None:
            return np.zeros(len(at))
        return np.interp(at, half.position, half.sigma / scale_of(find_unit(symbol)))

    def rotation_rad(
        self, axis: str, at_mm: Float64[np.ndarray, " n"]
    ) -> Float64[np.ndarray, "n 3"]:
        """Components of ω; 0 where the result has no angular error motion."""
        omega = np.zeros((len(at_mm), 3))
        model = self.result.model
        for motion in model.identifiable_motions:
            if motion.symbol[2] == axis and is_turn(motion.symbol):
                part = model.slices[motion.name]
                value = motion.rows(at_mm) @ self.result.theta[part]
                omega[:, DIRECTION[motion.symbol[1]]] = value
        return omega

    def move_axis(
        self,
        axis: LinearAxis,
        at_mm: Float64[np.ndarray, " n"],
        others_mm: Float64[np.ndarray, " a"],
    ) -> Float64[np.ndarray, "n a"]:
        """Positions of all axes where one axis moves alone."""
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


def find_own_arm(axis: Axis, at: Conditions) -> Float64[np.ndarray, "n 3"]:
    """Motion of the tool per mm or rad of an axis' positioning."""
    return compute_arm(f"E{axis.name}{axis.name}", at)


def map_errors(result: CalibrationResult) -> ErrorMap:
    """Map of a result, its lost motion across the axes completed."""
    return ErrorMap(complete_across(result), build_volumetric_map(result.model))


def tabulate_axis(
    errors: ErrorMap, measured: MeasuredRange, spacing_mm: float, most_points: int
) -> AxisTable:
    """Table of an axis, rows at most `spacing_mm` apart where they fit.

    It is 0 where the axis reaches its reference in + direction, as when it is homed.
    """
    axis = measured.axis
    travel = axis.high - axis.low
    wanted = math.ceil(travel / spacing_mm - 1e-9) + 1
    count = int(np.clip(wanted, 2, most_points))
    at_mm = np.linspace(axis.low, axis.high, count)
    reference = int(np.argmin(np.abs(at_mm - reference_position_mm(axis))))
    seen_mm, weight = measured.clip(at_mm), measured.weigh(at_mm)[:, None]
    place = errors.move_axis(axis, seen_mm, errors.middle_mm)
    # By direction a table has only the lost motion of the axis along itself.
    mean, half = errors.error_mm(place), np.zeros((count, 3))
    half[:, DIRECTION[axis.name]] = errors.half_difference(axis.name, seen_mm)
    forward, backward = mean + half, mean - half
    zero = forward[reference]
    translation, rotation = _tabulate_motions(errors, axis, seen_mm)
    pair = _tabulate_pair(errors, axis, seen_mm, most_points // count)
    return AxisTable(
        axis,
        at_mm,
        reference,
        weight * (forward - zero),
        weight * (backward - zero),
        weight * translation,
        weight * rotation,
        pair and replace(pair, error_mm=weight * pair.error_mm),
    )


def _tabulate_pair(
    errors: ErrorMap, axis: LinearAxis, at_mm: Float64[np.ndarray, " n"], most: int
) -> PairTable | None:
    """None without effects of two axes.

    most : positions of the other axis that the controller accepts
    """
    machine, model, theta = errors.machine, errors.result.model, errors.result.theta
    pairs = [effect.axis_pair for effect in model.effects if effect.axis_pair]
    by = next((b for a, b in pairs if a == axis.name), "")
    if not by or most < _FEWEST:
        return None
    effects = [one for one in model.effects if one.axis_pair == (axis.name, by)]
    other = machine.linear(by)
    by_mm = np.linspace(other.low, other.high, min(most, _FINEST))
    grid = np.stack(np.meshgrid(by_mm, at_mm, indexing="ij"), axis=-1).reshape(-1, 2)
    columns = [machine.axis_names.index(name) for name in (by, axis.name)]
    total = np.zeros((len(grid), 3))
    for kept, sign in (((0, 1), 1.0), ((0,), -1.0), ((1,), -1.0), ((), 1.0)):
        place = np.tile(errors.reference_mm, (len(grid), 1))
        for k in kept:
            place[:, columns[k]] = grid[:, k]
        at, error = make_standstill(machine, place), np.zeros((len(grid), 3))
        for one in effects:
            error += one.displacement_mm(at, theta[model.slices[one.name]])
        total += sign * error
    return PairTable(other, by_mm, total.reshape(len(by_mm), len(at_mm), 3))


def _tabulate_motions(
    errors: ErrorMap, axis: LinearAxis, at_mm: Float64[np.ndarray, " n"]
) -> tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n 3"]]:
    """E and ω of an axis, squareness and the target's offset in E.

    With the others at their reference, where their ω are 0, δ changes along the axis by
    E + ω × R, R the positions of the later axes there.
    """
    machine = errors.machine
    rest = errors.reference_mm
    at_and_zero = np.append(at_mm, reference_position_mm(axis))
    error = errors.error_mm(errors.move_axis(axis, at_and_zero, rest))
    omega = errors.rotation_rad(axis.name, at_mm)
    later = machine.order[machine.order.index(axis.name) + 1 :]
    lever = np.array(
        [rest[machine.axis_names.index(n)] if n in later else 0.0 for n in LINEAR]
    )
    return error[:-1] - error[-1] - np.cross(omega, lever), omega
