"""Error tables in files: `error_tables.csv`, and the keys that JSON files share."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from truepath.estimation.problem.observability import Observability
from truepath.estimation.solve.extrapolation import Ranges
from truepath.files.earlier.verdict import Verdict
from truepath.kinematics.machine.machine import Machine, position_unit
from truepath.results.error_tables import ErrorTable, ErrorTables

HEADER = ["error", "position_mm", "value", "uncertainty", "unit", "extrapolated"]


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
    return {
        "error_tables": {
            t.symbol: _columns_json(t) | {"extrapolated": t.extrapolated.tolist()}
            for t in tables.tables
        },
        "squareness_urad": {
            s.symbol: {"value": s.value, "uncertainty": s.uncertainty}
            for s in tables.squareness
        },
        **_locations_json(tables),
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


def _locations_json(tables: ErrorTables) -> dict[str, Any]:
    places = {
        place.symbol: {
            f"value_{place.unit}": place.value,
            f"uncertainty_{place.unit}": place.uncertainty,
        }
        for place in tables.locations
    }
    return {"axis_location": places} if places else {}
