"""Heidenhain TNC: a `.COM` table an axis and the `config.cma` that activates them.

Columns `AXISPOS`, `BACKLASH` (added in negative travel) and one for each axis that is
corrected: [axis of the column] = F(axis of the file). The sign is taken to be that of
what is added to the command, and has to be tried at the machine; so have the bytes of
the header, for which a file of that machine is the model. Source: MANUALplus 620
technical manual (compensation tables).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from truepath.app.compensation.format import (
    AxisTable,
    CompensationTables,
    InterpolatedTable,
    TableFormat,
)
from truepath.app.errors import BadInput
from truepath.app.kinematics.machine import Machine
from truepath.app.kinematics.symbols import LINEAR

_WIDTH = 12
_NUMBERS = ("AXISPOS", "BACKLASH", *LINEAR)
_CONFIG = "config.cma"


class Heidenhain(TableFormat):
    """A table an axis: positioning with backlash, straightness, squareness."""

    control = "Heidenhain TNC"
    suffix = ".com"
    most_points = 256
    resolution_um = 1e-2
    carries = (
        "positioning with backlash, straightness and squareness along the middle of "
        "the travel"
    )
    not_carried = "angular errors away from the middle (KinematicsComp has them)"
    sign = "the value is added to the commanded position: minus the error"
    sign_is_verified = False
    note = (
        "copy the header line and column widths from a table of this control before "
        "first use; older controls want a spacing that is a power of two of 0.1 µm"
    )

    def write(self, content: CompensationTables) -> dict[str, str]:
        """Return `STEM-X.com` for each axis, and `config.cma`."""
        names = {t.axis.name: f"{content.stem}-{t.axis.name}" for t in content.tables}
        files = {
            f"{names[t.axis.name]}{self.suffix}": _write_table(names[t.axis.name], t)
            for t in content.tables
        }
        return {**files, _CONFIG: _write_config(names, self.suffix)}

    def read_tables(
        self, files: Mapping[str, str], machine: Machine
    ) -> Iterator[InterpolatedTable]:
        """Yield the tables named by `config.cma`."""
        row = _read_rows(files[_CONFIG])[0]
        if row.get("ACTIVE") != "*":
            raise BadInput(f"{_CONFIG}: no line is active")
        for axis, name in row.items():
            if axis in LINEAR:
                yield from _read_columns(axis, _read_rows(files[name]))


def _write_table(name: str, table: AxisTable) -> str:
    columns = ("NR", *_NUMBERS)
    lines = [f"BEGIN {name} .COM MM", _format_line(columns)]
    values = -table.forward_mm
    lost = (table.forward_mm - table.backward_mm)[:, table.own]
    for number, (at, back, row) in enumerate(
        zip(table.position_mm, lost, values, strict=True)
    ):
        numbers = (f"{at:+.4f}", f"{back:+z.5f}", *(f"{v:+z.5f}" for v in row))
        lines.append(_format_line((str(number), *numbers)))
    return "\n".join([*lines, "[END]", ""])


def _write_config(names: Mapping[str, str], suffix: str) -> str:
    width = max(_WIDTH, *(len(n) + len(suffix) + 2 for n in names.values()))
    head = _format_line(("NR", "ACTIVE", *names), width)
    row = _format_line(("0", "*", *(f"{n}{suffix}" for n in names.values())), width)
    return "\n".join(
        [f"BEGIN {_CONFIG.removesuffix('.cma')} .CMA", head, row, "[END]", ""]
    )


def _format_line(cells: tuple[str, ...], width: int = _WIDTH) -> str:
    return "".join(cell.ljust(width) for cell in cells).rstrip()


def _read_rows(text: str) -> list[dict[str, str]]:
    """Return the rows of a table by column name."""
    lines = text.splitlines()
    if len(lines) < 4 or not lines[0].startswith("BEGIN ") or lines[-1] != "[END]":
        raise BadInput("a table begins with BEGIN and ends with [END]")
    head = lines[1].split()
    return [dict(zip(head, line.split(), strict=True)) for line in lines[2:-1]]


def _read_columns(axis: str, rows: list[dict[str, str]]) -> Iterator[InterpolatedTable]:
    """Yield the columns of an axis: both directions alike, then the backlash."""
    columns = {n: np.array([float(row[n]) for row in rows]) for n in _NUMBERS}
    at = columns["AXISPOS"]
    for out, name in enumerate(LINEAR):
        yield InterpolatedTable(axis, out, at, columns[name])
    own, zero = LINEAR.index(axis), np.zeros(len(at))
    yield InterpolatedTable(axis, own, at, zero, columns["BACKLASH"])
