"""Heidenhain TNC: a `.COM` table an axis and the `config.cma` that activates them.

Columns `AXISPOS`, `BACKLASH` (added in negative travel) and one for each axis that is
corrected: [axis of the column] = F(axis of the file). The sign is taken to be that of
what is added to the command, and has to be tried at the machine; so have the bytes of
the header, for which a file of that machine is the model. Source: MANUALplus 620
technical manual (compensation tables).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from jaxtyping import Float64

from app.compensation.format import CompensationFormat, Correction
from app.compensation.order import AxisTable, CompensationOrder
from app.errors import BadInput
from app.kinematics.machine import Machine
from app.kinematics.symbols import LINEAR

_WIDTH = 12
_CONFIG = "config.cma"


class Heidenhain(CompensationFormat):
    """A table an axis: positioning with backlash, straightness, squareness."""

    control: ClassVar[str] = "Heidenhain TNC"
    suffix: ClassVar[str] = ".com"
    most_points: ClassVar[int] = 256
    carries: ClassVar[str] = (
        "positioning with backlash, straightness and squareness along the middle of "
        "the travel"
    )
    not_carried: ClassVar[str] = (
        "angular errors away from the middle (KinematicsComp has them)"
    )
    sign: ClassVar[str] = (
        "the value is added to the commanded position: minus the error"
    )
    sign_is_verified: ClassVar[bool] = False
    note: ClassVar[str] = (
        "copy the header line and column widths from a table of this control before "
        "first use; older controls want a spacing that is a power of two of 0.1 µm"
    )

    def write(self, order: CompensationOrder) -> dict[str, str]:
        """Return `STEM-X.com` for each axis, and `config.cma`."""
        names = {t.axis.name: f"{order.stem}-{t.axis.name}" for t in order.tables}
        files = {
            f"{names[t.axis.name]}{self.suffix}": _table(names[t.axis.name], t)
            for t in order.tables
        }
        return {**files, _CONFIG: _config(names, self.suffix)}

    def read(self, files: Mapping[str, str], machine: Machine) -> Correction:
        """Return what the tables named by `config.cma` add."""
        row = _rows(files[_CONFIG])[0]
        if row.get("ACTIVE") != "*":
            raise BadInput(f"{_CONFIG}: no line is active")
        tables = {
            axis: _rows(files[name]) for axis, name in row.items() if axis in LINEAR
        }

        def correction(
            position_mm: Float64[np.ndarray, "n a"], direction: float
        ) -> Float64[np.ndarray, "n 3"]:
            added = np.zeros((len(position_mm), 3))
            for axis, rows in tables.items():
                at = position_mm[:, machine.axis_names.index(axis)]
                for out, column in enumerate(LINEAR):
                    added[:, out] += _between(rows, column, at)
                if direction < 0:
                    added[:, LINEAR.index(axis)] += _between(rows, "BACKLASH", at)
            return added

        return correction


def _table(name: str, table: AxisTable) -> str:
    columns = ("NR", "AXISPOS", "BACKLASH", *LINEAR)
    lines = [f"BEGIN {name} .COM MM", _line(columns)]
    values = -table.forward_mm
    lost = (table.forward_mm - table.backward_mm)[:, table.own]
    for number, (at, back, row) in enumerate(
        zip(table.position_mm, lost, values, strict=True)
    ):
        numbers = (f"{at:+.4f}", f"{back:+z.5f}", *(f"{v:+z.5f}" for v in row))
        lines.append(_line((str(number), *numbers)))
    return "\n".join([*lines, "[END]", ""])


def _config(names: Mapping[str, str], suffix: str) -> str:
    width = max(_WIDTH, *(len(n) + len(suffix) + 2 for n in names.values()))
    head = _line(("NR", "ACTIVE", *names), width)
    row = _line(("0", "*", *(f"{n}{suffix}" for n in names.values())), width)
    return "\n".join(
        [f"BEGIN {_CONFIG.removesuffix('.cma')} .CMA", head, row, "[END]", ""]
    )


def _line(cells: tuple[str, ...], width: int = _WIDTH) -> str:
    return "".join(cell.ljust(width) for cell in cells).rstrip()


def _rows(text: str) -> list[dict[str, str]]:
    """Return the rows of a table by column name."""
    lines = text.splitlines()
    if len(lines) < 4 or not lines[0].startswith("BEGIN ") or lines[-1] != "[END]":
        raise BadInput("a table begins with BEGIN and ends with [END]")
    head = lines[1].split()
    return [dict(zip(head, line.split(), strict=True)) for line in lines[2:-1]]


def _between(
    rows: list[dict[str, str]], column: str, at_mm: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, " n"]:
    position = [float(row["AXISPOS"]) for row in rows]
    return np.interp(at_mm, position, [float(row[column]) for row in rows])
