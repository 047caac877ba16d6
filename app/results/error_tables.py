"""Error motions as tables over their axes, each value with its standard uncertainty."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64

from app.estimation.extrapolation import Ranges
from app.kinematics.effects.error_curve import ErrorCurve
from app.kinematics.machine import Axis, RotaryAxis, Target
from app.kinematics.model import MachineModel
from app.kinematics.symbols import SQUARENESS, is_turn, unit

STEP_MM = 25.0
STEP_DEG = 10.0
_FEWEST = 5
MICRO = 1e6  # rad to µrad
MILLI = 1e3  # mm to µm


@dataclass(frozen=True, slots=True)
class ErrorTable:
    """One error motion at positions of its axis.

    unit : "um" or "urad", of `value` and `uncertainty`
    position_mm : of the axis; in deg where `position_unit` says so
    uncertainty : standard uncertainty (k = 1) in the gauge of the table
    measured : lowest and highest position that was measured; None where nobody knows
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
        """Tell which positions lie beyond the measured range."""
        if self.measured is None:
            return np.zeros(len(self.position_mm), bool)
        low, high = self.measured
        return (self.position_mm < low) | (self.position_mm > high)


@dataclass(frozen=True, slots=True)
class LocationError:
    """A location error of a rotary axis, with its standard uncertainty (k = 1).

    unit : "um" or "urad", of `value` and `uncertainty`
    """

    symbol: str
    unit: str
    value: float
    uncertainty: float


@dataclass(frozen=True, slots=True)
class SquarenessError:
    """A squareness, with its standard uncertainty (k = 1)."""

    symbol: str
    value_urad: float
    uncertainty_urad: float


@dataclass(frozen=True, slots=True)
class ErrorTables:
    """All error motions that are known, and the target offsets they hold for.

    targets : the targets that were measured
    any_tool : all six motions of every axis are known: the tables hold for any offset
    """

    tables: tuple[ErrorTable, ...]
    squareness: tuple[SquarenessError, ...]
    targets: tuple[Target, ...]
    any_tool: bool
    locations: tuple[LocationError, ...] = ()

    def table(self, symbol: str) -> ErrorTable | None:
        """Return the table of an error motion, or None where it is not known."""
        return next((t for t in self.tables if t.symbol == symbol), None)


def error_tables(
    model: MachineModel,
    theta: Float64[np.ndarray, " p"],
    covariance: Float64[np.ndarray, "p p"],
    measured: Ranges | None = None,
) -> ErrorTables:
    """Return the tables of an estimate's parameters.

    measured : by axis, the range that was measured, if it is known
    """
    ranges = measured or {}
    tables: list[ErrorTable] = []
    squareness: list[SquarenessError] = []
    locations: list[LocationError] = []
    for effect in model.effects:
        part = model.slices[effect.name]
        symbol = effect.iso_symbol
        if motion := effect.motion:
            at_mm = table_positions_mm(motion.axis)
            table = error_table(motion, theta[part], covariance[part, part], at_mm)
            tables.append(replace(table, measured=ranges.get(motion.axis.name)))
        elif symbol in SQUARENESS:
            value, variance = float(theta[part][0]), float(covariance[part, part][0, 0])
            sigma = float(np.sqrt(variance))
            squareness.append(SquarenessError(symbol, MICRO * value, MICRO * sigma))
        elif symbol:
            sigma = float(np.sqrt(covariance[part, part][0, 0]))
            locations.append(_location(symbol, float(theta[part][0]), sigma))
    complete = len(tables) == 6 * len(model.machine.axes)
    return ErrorTables(
        tuple(tables),
        tuple(squareness),
        model.machine.targets,
        complete,
        tuple(locations),
    )


def _location(symbol: str, value: float, sigma: float) -> LocationError:
    stated = unit(symbol)
    scale = MICRO if stated == "urad" else MILLI
    return LocationError(symbol, stated, scale * value, scale * sigma)


def table_positions_mm(axis: Axis) -> Float64[np.ndarray, " n"]:
    """Return equidistant positions about 25 mm or 10 deg apart, both ends included."""
    step = STEP_DEG if isinstance(axis, RotaryAxis) else STEP_MM
    intervals = round((axis.high - axis.low) / step)
    return np.linspace(axis.low, axis.high, max(intervals + 1, _FEWEST))


def error_table(
    motion: ErrorCurve,
    theta: Float64[np.ndarray, " p"],
    covariance: Float64[np.ndarray, "p p"],
    position_mm: Float64[np.ndarray, " n"],
) -> ErrorTable:
    """Return one error motion at given positions, from its own parameters."""
    turn = is_turn(motion.symbol)
    scale = MICRO if turn else MILLI
    rows = motion.rows(position_mm)
    variance = np.einsum("np,np->n", rows @ covariance, rows)
    sigma = np.sqrt(np.maximum(variance, 0.0))
    return ErrorTable(
        motion.symbol,
        "urad" if turn else "um",
        position_mm,
        scale * (rows @ theta),
        scale * sigma,
        "deg" if isinstance(motion.axis, RotaryAxis) else "mm",
    )
