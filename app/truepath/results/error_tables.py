"""Error motions as tables over their axes, each value with its standard uncertainty."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64

from truepath.estimation.solve.extrapolation import Ranges
from truepath.files.units import scale_of
from truepath.kinematics.effects.base import ErrorCurve
from truepath.kinematics.machine.machine import Axis, RotaryAxis, Target, position_unit
from truepath.kinematics.machine.symbols import SQUARENESS, find_unit
from truepath.kinematics.model import EstimatedModel

STEP_MM = 25.0
STEP_DEG = 10.0
_FEWEST = 5


@dataclass(frozen=True, slots=True)
class ErrorTable:
    """One error motion at positions of its axis.

    unit : "um" or "urad", of `value` and `uncertainty`
    position_mm : of the axis; in deg where `position_unit` says so
    uncertainty : standard uncertainty (k = 1) in the gauge of the table
    measured : lowest and highest position that was measured; None where unknown
    """

    symbol: str
    unit: str
    position_mm: Float64[np.ndarray, " n"]
    value: Float64[np.ndarray, " n"]
    uncertainty: Float64[np.ndarray, " n"]
    position_unit: str = "mm"
    measured: tuple[float, float] | None = None

    @property
    def extrapolated(self) -> Bool[np.ndarray, " n"]:
        """Beyond the measured range; nowhere if that is unknown."""
        if self.measured is None:
            return np.zeros(len(self.position_mm), bool)
        low, high = self.measured
        return (self.position_mm < low) | (self.position_mm > high)


@dataclass(frozen=True, slots=True)
class SingleError:
    """A squareness, or a location error of a rotary axis: one number.

    unit : "um" or "urad", of `value` and its standard `uncertainty` (k = 1)
    """

    symbol: str
    unit: str
    value: float
    uncertainty: float


@dataclass(frozen=True, slots=True)
class ErrorTables:
    """All error motions that are known, and the target offsets they hold for.

    targets : the targets that were measured
    any_tool : all six motions of every axis are known: the tables hold for any offset
    """

    tables: tuple[ErrorTable, ...]
    squareness: tuple[SingleError, ...]
    targets: tuple[Target, ...]
    any_tool: bool
    locations: tuple[SingleError, ...] = ()

    def table(self, symbol: str) -> ErrorTable | None:
        """None where the error motion is not known."""
        return next((t for t in self.tables if t.symbol == symbol), None)


def build_error_tables(
    estimated: EstimatedModel, measured: Ranges | None = None
) -> ErrorTables:
    """Of an estimate, or of a result or model file.

    measured : by axis, the range that was measured, if it is known
    """
    ranges, estimated = measured or {}, estimated.reduce_to_targets
    model = estimated.model
    tables: list[ErrorTable] = []
    squareness: list[SingleError] = []
    locations: list[SingleError] = []
    for effect in model.effects:
        if effect.name in model.confounded:
            continue
        if motion := effect.motion:
            at_mm = choose_table_positions(motion.axis)
            table = build_error_table(estimated, motion, at_mm)
            tables.append(replace(table, measured=ranges.get(motion.axis.name)))
        elif symbol := effect.iso_symbol:
            value, sigma = evaluate(symbol, np.eye(1), *estimated.part(effect.name))
            single = SingleError(
                symbol, find_unit(symbol), float(value[0]), float(sigma[0])
            )
            (squareness if symbol in SQUARENESS else locations).append(single)
    return ErrorTables(
        tuple(tables),
        tuple(squareness),
        model.machine.targets,
        model.knows_all_motions,
        tuple(locations),
    )


def choose_table_positions(axis: Axis) -> Float64[np.ndarray, " n"]:
    """Equidistant, about 25 mm or 10 deg apart, 5 at least, both ends included."""
    step = STEP_DEG if isinstance(axis, RotaryAxis) else STEP_MM
    intervals = round((axis.high - axis.low) / step)
    return np.linspace(axis.low, axis.high, max(intervals + 1, _FEWEST))


def build_error_table(
    estimated: EstimatedModel,
    motion: ErrorCurve,
    position_mm: Float64[np.ndarray, " n"],
) -> ErrorTable:
    """One error motion at given positions, in the unit of its axis."""
    part = estimated.reduce_to_targets.part(motion.symbol)
    stated = evaluate(motion.symbol, motion.rows(position_mm), *part)
    return ErrorTable(
        motion.symbol,
        find_unit(motion.symbol),
        position_mm,
        *stated,
        position_unit(motion.axis),
    )


def compute_half_differences(estimated: EstimatedModel) -> tuple[ErrorTable, ...]:
    """Half the difference of both directions of each error motion that has one.

    The error in + direction is the table plus the half difference, in − direction the
    table less it.
    """
    estimated = estimated.reduce_to_targets
    model = estimated.model
    parts = [
        (effect.name, half)
        for effect in model.effects
        if (half := effect.half_difference)
    ]
    tables: list[ErrorTable] = []
    for symbol, axis in {half.symbol: half.axis for _, half in parts}.items():
        at_mm = choose_table_positions(axis)
        rows = np.zeros((len(at_mm), model.size))
        for name, half in parts:
            if half.symbol == symbol:
                rows[:, model.slices[name]] = half.rows(at_mm)
        stated = evaluate(symbol, rows, estimated.theta, estimated.covariance)
        unit = position_unit(axis)
        tables.append(ErrorTable(symbol, find_unit(symbol), at_mm, *stated, unit))
    return tuple(tables)


def evaluate(
    symbol: str,
    rows: Float64[np.ndarray, "n p"],
    theta: Float64[np.ndarray, " p"],
    covariance: Float64[np.ndarray, "p p"],
) -> tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
    """Values linear in the parameters, and their uncertainties, in µm or µrad."""
    scale = scale_of(find_unit(symbol))
    variance = np.einsum("np,np->n", rows @ covariance, rows)
    return scale * (rows @ theta), scale * np.sqrt(np.maximum(variance, 0.0))
