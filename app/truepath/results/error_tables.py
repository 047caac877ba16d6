"""Error motions as tables over their axes, each value with its standard uncertainty.

As records, as `error_tables.csv`, and as the keys that JSON files share.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64

from truepath.estimation.problem.observability import Observability
from truepath.estimation.solve.extrapolation import Ranges
from truepath.files.earlier.verdict import Verdict
from truepath.files.units import scale_of
from truepath.kinematics.effects.base import ErrorCurve
from truepath.kinematics.machine.machine import (
    Axis,
    Machine,
    RotaryAxis,
    Target,
    position_unit,
)
from truepath.kinematics.machine.symbols import SQUARENESS, find_unit
from truepath.kinematics.model import EstimatedModel

STEP_MM = 25.0
STEP_DEG = 10.0
HEADER = ["error", "position_mm", "value", "uncertainty", "unit", "extrapolated"]


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
    return np.linspace(axis.low, axis.high, max(intervals + 1, 5))


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


def error_tables_csv(tables: ErrorTables, verdict: Verdict) -> str:
    """Every value on a row of its own; uncertainties are standard ones (k = 1).

    A squareness belongs to no position: its cell is empty. `extrapolated` is 1 beyond
    the measured range of the axis. A machine with rotary axes has a further column,
    `position_deg`. The last column is the state of the verdict, so that copied rows
    keep it.
    """
    turns = any(table.position_unit == "deg" for table in tables.tables)
    cells = len(HEADER) + turns
    head = [*HEADER, "position_deg"][:cells]
    rows = (row[:cells] for row in _list_rows(tables, turns=turns))
    full = [[*head, "verdict"], *([*row, verdict.state] for row in rows)]
    return "".join(f"{','.join(row)}\n" for row in full)


def _list_rows(tables: ErrorTables, *, turns: bool) -> Iterator[list[str]]:
    for t in tables.tables:
        columns = t.position_mm, t.value, t.uncertainty, t.extrapolated
        for at, value, sigma, beyond in zip(*columns, strict=True):
            mm, deg = f"{at:.4f}", ""
            if t.position_unit == "deg":
                mm, deg = deg, mm
            numbers = f"{value:z.5f}", f"{sigma:.5f}"
            yield [t.symbol, mm, *numbers, t.unit, str(int(beyond)), deg]
    for single in (*tables.squareness, *(tables.locations if turns else ())):
        numbers = f"{single.value:z.5f}", f"{single.uncertainty:.5f}"
        yield [single.symbol, "", *numbers, single.unit, "", ""]


def tables_json(
    tables: ErrorTables,
    halves: Sequence[ErrorTable],
    direction: str,
    measured: Ranges,
    machine: Machine,
) -> dict[str, Any]:
    """The keys of all tables.

    direction : the estimate's own model of the direction of approach
    """
    # A prior effect, such as lost motion, also makes half differences.
    model = "constant" if halves and direction == "none" else direction
    locations = {
        one.symbol: {
            f"value_{one.unit}": one.value,
            f"uncertainty_{one.unit}": one.uncertainty,
        }
        for one in tables.locations
    }
    return {
        "error_tables": {
            t.symbol: _columns_json(t) | {"extrapolated": t.extrapolated.tolist()}
            for t in tables.tables
        },
        "squareness_urad": {
            s.symbol: {"value": s.value, "uncertainty": s.uncertainty}
            for s in tables.squareness
        },
        **({"axis_location": locations} if locations else {}),
        "direction": {
            "model": model,
            "half_difference": {h.symbol: _columns_json(h) for h in halves},
        },
        "measured_range": {
            axis.name: dict(
                zip(
                    (f"from_{position_unit(axis)}", f"to_{position_unit(axis)}"),
                    measured[axis.name],
                    strict=True,
                )
            )
            for axis in machine.axes
            if axis.name in measured
        },
    }


def observability_json(found: Observability) -> dict[str, Any]:
    """Rank, and parameters that the data do not determine, or only weakly."""
    return {
        "rank": found.rank,
        "parameters": found.parameters,
        "unobservable": list(found.unobservable),
        "weak": list(found.poorly_observable),
    }


def _columns_json(table: ErrorTable) -> dict[str, Any]:
    return {
        f"position_{table.position_unit}": table.position_mm.tolist(),
        f"value_{table.unit}": table.value.tolist(),
        f"uncertainty_{table.unit}": table.uncertainty.tolist(),
    }
