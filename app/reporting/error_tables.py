"""Error motions as tables over their axes, each value with its standard uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.kinematics.effects.error_motion import ErrorMotion
from app.kinematics.effects.squareness import Squareness
from app.kinematics.machine import LinearAxis, Target
from app.kinematics.model import MachineModel
from app.kinematics.symbols import is_turn

STEP_MM = 25.0
_FEWEST = 5
MICRO = 1e6  # rad to µrad
MILLI = 1e3  # mm to µm


@dataclass(frozen=True, slots=True)
class ErrorTable:
    """One error motion at positions of its axis.

    unit : "um" or "urad", of `value` and `uncertainty`
    uncertainty : standard uncertainty (k = 1) in the gauge of the table
    """

    symbol: str
    unit: str
    position_mm: Float64[np.ndarray, " n"]
    value: Float64[np.ndarray, " n"]
    uncertainty: Float64[np.ndarray, " n"]


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

    def table(self, symbol: str) -> ErrorTable | None:
        """Return the table of an error motion, or None where it is not known."""
        return next((t for t in self.tables if t.symbol == symbol), None)


def error_tables(
    model: MachineModel,
    theta: Float64[np.ndarray, " p"],
    covariance: Float64[np.ndarray, "p p"],
) -> ErrorTables:
    """Return the tables of an estimate's parameters."""
    tables: list[ErrorTable] = []
    squareness: list[SquarenessError] = []
    for effect in model.effects:
        part = model.slices[effect.name]
        if isinstance(effect, ErrorMotion):
            at_mm = table_positions_mm(effect.axis)
            tables.append(
                error_table(effect, theta[part], covariance[part, part], at_mm)
            )
        elif isinstance(effect, Squareness):
            value, variance = float(theta[part][0]), float(covariance[part, part][0, 0])
            sigma = float(np.sqrt(variance))
            squareness.append(
                SquarenessError(effect.symbol, MICRO * value, MICRO * sigma)
            )
    complete = len(tables) == 6 * len(model.machine.linear_axes)
    return ErrorTables(
        tuple(tables), tuple(squareness), model.machine.targets, complete
    )


def table_positions_mm(axis: LinearAxis) -> Float64[np.ndarray, " n"]:
    """Return equidistant positions about 25 mm apart, both ends included."""
    intervals = round((axis.max_mm - axis.min_mm) / STEP_MM)
    return np.linspace(axis.min_mm, axis.max_mm, max(intervals + 1, _FEWEST))


def error_table(
    motion: ErrorMotion,
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
    )
