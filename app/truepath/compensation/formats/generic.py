"""Plain tables of all error motions for user software: CSV and JSON.

A row is an axis, the direction it moves in, its position, and its six error motions
there. Squareness is in the straightness and the target's offset in the displacements,
so that the error at positions p of the axes is, over the axes of the chain,

    δ = Σ E(p) + ω(p) × R,

R the positions of the axes nearer to the tool; the correction is −δ. Tables are
interpolated linearly and hold their end values.
"""

from __future__ import annotations

import csv
import io
import json
from abc import abstractmethod
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float64

from truepath.compensation.format import (
    AxisTable,
    CompensationFormat,
    CompensationTables,
    Correction,
    Files,
    RotaryAxisLocation,
    list_stated_locations,
)
from truepath.compensation.tables.motion_correction import (
    correct_by_motions,
    interpolate_rows,
)
from truepath.errors import BadInput
from truepath.files.units import UM_PER_MM, URAD_PER_RAD
from truepath.kinematics.machine.machine import Machine
from truepath.kinematics.machine.symbols import find_unit

_MOTIONS = ("x_um", "y_um", "z_um", "a_urad", "b_urad", "c_urad")
_COLUMNS = ("axis", "direction", "position_mm", *_MOTIONS)
_PER_KELVIN = tuple(f"{name}_per_K" for name in _MOTIONS)
_UNITS = np.array([UM_PER_MM] * 3 + [URAD_PER_RAD] * 3)
_SIDES = {"+": 1.0, "-": -1.0}

Row = tuple[str, str, float, list[float]]
"""Axis, direction, position in mm, six motions in µm and µrad, and their change per K
where the tables are of a temperature model."""


class GenericTables(CompensationFormat):
    """All error motions of each linear axis, in both directions."""

    most_points = 10_000
    carries = (
        "all error motions and squareness, with their lever arms in the whole volume; "
        "positioning in both directions"
    )
    not_carried = (
        "what an axis does with another one, as sag; lost motion across or about "
        "an axis"
    )
    temperature = (
        "the change of each row per kelvin, in columns of its own: at a temperature T "
        "a row is its value + (T - the stated temperature) times its change"
    )
    units = "um and urad, positions mm"
    directions = "each by itself"
    sign = "the rows are the errors: actual less nominal; the correction is minus that"
    sign_is_verified = True
    note = (
        "error = sum over the axes of (x, y, z) + (a, b, c) x R, R the positions of "
        "the axes nearer to the tool; straight between rows, end values hold"
    )

    @abstractmethod
    def write_rows(self, content: CompensationTables, rows: Sequence[Row]) -> str:
        """Text of the file."""

    @abstractmethod
    def read_rows(self, name: str, text: str) -> Iterator[Row]:
        """Raises BadInput."""

    def write(self, content: CompensationTables) -> dict[str, str]:
        """One file for all axes."""
        rows = list(_list_all_rows(content))
        return {f"{content.stem}{self.suffix}": self.write_rows(content, rows)}

    def read(self, files: Files, machine: Machine) -> Correction:
        """Minus the error of the chain from the motions."""
        ((name, text),) = files.items()
        found: dict[tuple[str, float], list[list[float]]] = {}
        for axis, side, at_mm, motions in self.read_rows(name, text):
            found.setdefault((axis, _SIDES[side]), []).append([at_mm, *motions[:6]])
        tables = {key: np.array(rows) for key, rows in found.items()}
        for table in tables.values():
            table[:, 1:] /= _UNITS

        def find_motion(
            axis: str, position_mm: Float64[np.ndarray, "n a"], direction: float
        ) -> Float64[np.ndarray, "n 6"]:
            at = position_mm[:, machine.axis_names.index(axis)]
            return interpolate_rows(tables[axis, direction], at)

        return correct_by_motions(machine, {axis for axis, _ in tables}, find_motion)


class GenericCsv(GenericTables):
    """Rows of comma-separated values below comments that begin with #."""

    control = "Plain table, CSV"
    suffix = ".csv"

    def write_rows(self, content: CompensationTables, rows: Sequence[Row]) -> str:
        """Comments, column names, rows."""
        text = io.StringIO()
        text.writelines(f"# {line}\n" for line in content.stamp)
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(_list_columns(content))
        for axis, side, at_mm, motions in rows:
            numbers = [f"{value:z.4f}" for value in motions]
            writer.writerow([axis, side, f"{at_mm:.6f}", *numbers])
        return text.getvalue()

    def read_rows(self, name: str, text: str) -> Iterator[Row]:
        """Rows below the column names."""
        lines = [line for line in text.splitlines() if not line.startswith("#")]
        header, *rows = csv.reader(lines)
        _require_columns(name, header)
        for axis, side, at_mm, *motions in rows:
            yield axis, side, float(at_mm), [float(value) for value in motions]


class GenericJson(GenericTables):
    """One document: origin of the tables, and rows by axis and direction."""

    control = "Plain table, JSON"
    suffix = ".tables.json"  # STEM.json is the account

    def write_rows(self, content: CompensationTables, rows: Sequence[Row]) -> str:
        """A document with one line per row of motions."""
        document: dict[str, Any] = {
            "schema": "compensation-tables/1",
            "stamp": list(content.stamp),
            "kinematic_chain": content.machine.chain,
            **_describe_places(content.places),
            "columns": list(_list_columns(content)),
            "rows": [[axis, side, at, *motions] for axis, side, at, motions in rows],
        }
        return json.dumps(document, indent=1) + "\n"

    def read_rows(self, name: str, text: str) -> Iterator[Row]:
        """Rows of the document."""
        document = json.loads(text)
        _require_columns(name, document.get("columns") or [])
        for axis, side, at_mm, *motions in document["rows"]:
            yield axis, side, at_mm, motions

    def list_written_locations(
        self, machine: Machine, places: Sequence[RotaryAxisLocation]
    ) -> frozenset[str]:
        """All locations that the result has."""
        del machine
        return list_stated_locations(places)

    def read_locations(self, files: Files, machine: Machine) -> dict[str, float]:
        """Locations of rotary axes in the document, mm and rad."""
        (text,) = files.values()
        stated = json.loads(text).get("rotary_axes", {}).values()
        units = {"um": 1e-3, "urad": 1e-6}
        return {
            symbol: units[find_unit(symbol)] * number
            for one in stated
            for symbol, number in one["location"].items()
        }


def _describe_places(places: Sequence[RotaryAxisLocation]) -> dict[str, Any]:
    """At the zero of all axes; empty without rotary axes."""
    scale = {"um": 1e3, "urad": 1e6}
    found = {
        place.axis.name: {
            "nominal_origin_mm": list(place.axis.origin_mm),
            "nominal_direction": list(place.axis.direction),
            "origin_mm": [round(float(v), 6) for v in place.origin_mm],
            "direction": [round(float(v), 9) for v in place.direction],
            "location": {
                symbol: round(scale[find_unit(symbol)] * value, 4)
                for symbol, value in place.location.items()
            },
            "location_unit": "um for shifts, urad for tilts",
        }
        for place in places
    }
    return {"rotary_axes": found} if found else {}


def _list_columns(content: CompensationTables) -> tuple[str, ...]:
    return _COLUMNS if content.temperature is None else (*_COLUMNS, *_PER_KELVIN)


def _require_columns(name: str, columns: Sequence[str]) -> None:
    if tuple(columns) not in (_COLUMNS, (*_COLUMNS, *_PER_KELVIN)):
        raise BadInput(f"{name}: the columns are to be {', '.join(_COLUMNS)}")


def _list_all_rows(content: CompensationTables) -> Iterator[Row]:
    if content.temperature is None:
        yield from (row for table in content.tables for row in _list_rows(table))
        return
    pairs = zip(content.tables, content.temperature.per_kelvin, strict=True)
    for table, change in pairs:
        both = zip(_list_rows(table), _list_rows(change), strict=True)
        for (axis, side, at_mm, motions), (*_, slopes) in both:
            yield axis, side, at_mm, [*motions, *slopes]


def _list_rows(table: AxisTable) -> Iterator[Row]:
    """0 where the reference is reached in + direction."""
    half, own = np.zeros_like(table.forward_mm), table.own
    half[:, own] = 0.5 * (table.forward_mm - table.backward_mm)[:, own]
    for side, sign in _SIDES.items():
        shift = sign * half - half[table.reference]
        moved = np.hstack([table.translation_mm + shift, table.rotation_rad])
        rounded = np.round(moved * _UNITS, 4)
        for at_mm, motions in zip(table.position_mm, rounded, strict=True):
            yield table.axis.name, side, float(at_mm), (motions + 0.0).tolist()
