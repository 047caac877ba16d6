"""Heidenhain TNC: a `.COM` table per axis and the `config.cma` that activates them.

Columns `AXISPOS`, `BACKLASH` and one for each axis that is corrected: [axis of the
column] = F(axis of the file). The manual has "the compensation values measured in the
negative direction of traverse" in BACKLASH: whether that is the value in negative
travel or what is added to the other there is a choice, and the column is left out where
direction has no effect. The values are those of the error curve, which the control
subtracts. That has to be tried at the machine all the same; so do the bytes of the
header, for which a file of that machine is the model. Sources: MANUALplus 620 Technical
Manual, pages 716 to 718; of the sign TNC 407 Technical Manual, pages 152 and 153, TNC
306, page 121, iTNC 530 HSCI, pages 680 and 684.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import ClassVar

import numpy as np

from truepath.compensation.format import (
    AxisTable,
    CompensationTables,
    Files,
    InterpolatedTable,
    TableFormat,
)
from truepath.errors import BadInput
from truepath.kinematics.machine.machine import Machine
from truepath.kinematics.machine.symbols import LINEAR

_WIDTH = 12
_LEAST_MM = 5e-6  # of lost motion that has a column: half of the resolution
_CONFIG = "config.cma"
_WORDS = {
    "negative-value": "the value in negative travel "
    "(--backlash-reading negative-value)",
    "difference": "what is added to the other column in negative travel "
    "(--backlash-reading difference)",
}


class Heidenhain(TableFormat):
    """A table per axis: positioning with backlash, straightness, squareness."""

    control = "Heidenhain TNC"
    suffix = ".com"
    most_points = 256
    resolution_um = 1e-2
    carries = (
        "positioning with backlash, straightness and squareness along the middle of "
        "the travel"
    )
    not_carried = (
        "angular errors away from the middle (KinematicsComp has them); "
        "lost motion across or about an axis"
    )
    directions = "each by itself"
    sign = (
        "the value is the error, which the control takes away (earlier files of this "
        "program had the opposite sign)"
    )
    sign_is_verified = False
    choices: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "backlash_reading": tuple(_WORDS)
    }
    note = (
        "copy the header line and column widths from a table of this control before "
        "first use; older controls want a spacing that is a power of two of 0.1 µm. "
    )

    def __init__(self, backlash_reading: str = "negative-value") -> None:
        self._reading = backlash_reading
        self.note = Heidenhain.note + (
            "An axis with lost motion has a column BACKLASH, written as "
            f"{_WORDS[backlash_reading]}. Two minutes decide it and the sign: enter "
            "0.100 in every row of the axis' own column and of BACKLASH, activate, "
            "and come to one position from both sides under a dial gauge. No "
            "difference between the sides: negative-value; 0.1 mm of it: difference. "
            "It stands 0.1 mm further in - direction than without the table: "
            "the sign is right; further in +: turn the sign of every value"
        )

    def write(self, content: CompensationTables) -> dict[str, str]:
        """`STEM-X.com` for each axis, and `config.cma`."""
        names = {t.axis.name: f"{content.stem}-{t.axis.name}" for t in content.tables}
        files = {
            f"{names[t.axis.name]}{self.suffix}": _write_table(
                names[t.axis.name], t, self._reading
            )
            for t in content.tables
        }
        return {**files, _CONFIG: _write_config(names, self.suffix)}

    def read_tables(
        self, files: Files, machine: Machine
    ) -> Iterator[InterpolatedTable]:
        """Tables named in `config.cma`. Raises BadInput."""
        known = {name.lower(): text for name, text in files.items()}
        if _CONFIG not in known:
            raise BadInput(f"{_CONFIG} is missing: it names the table of each axis")
        row = _read_rows(known.pop(_CONFIG))[0]
        if row.get("ACTIVE") != "*":
            raise BadInput(f"{_CONFIG}: no line is active")
        for axis, name in row.items():
            if axis in LINEAR:
                if name.lower() not in known:
                    raise BadInput(f"{name} is missing: {_CONFIG} names it for {axis}")
                rows = _read_rows(known.pop(name.lower()))
                yield from _read_columns(axis, rows, self._reading)
        if known:
            raise BadInput(f"{min(known)}: {_CONFIG} does not name it")


def _write_table(name: str, table: AxisTable, reading: str) -> str:
    values = table.forward_mm
    back = table.backward_mm[:, table.own]
    lost = back - values[:, table.own]
    columns = ["NR", "AXISPOS", *LINEAR]
    numbers = [table.position_mm, *values.T]
    if np.abs(lost).max() > _LEAST_MM:
        columns.insert(2, "BACKLASH")
        numbers.insert(1, lost if reading == "difference" else back)
    lines = [f"BEGIN {name} .COM MM", _format_line(columns)]
    for number, (at, *row) in enumerate(zip(*numbers, strict=True)):
        cells = (str(number), f"{at:+.4f}", *(f"{value:+z.5f}" for value in row))
        lines.append(_format_line(cells))
    return "\n".join([*lines, "[END]", ""])


def _write_config(names: Mapping[str, str], suffix: str) -> str:
    width = max(_WIDTH, *(len(n) + len(suffix) + 2 for n in names.values()))
    head = _format_line(("NR", "ACTIVE", *names), width)
    row = _format_line(("0", "*", *(f"{n}{suffix}" for n in names.values())), width)
    return "\n".join(
        [f"BEGIN {_CONFIG.removesuffix('.cma')} .CMA", head, row, "[END]", ""]
    )


def _format_line(cells: Sequence[str], width: int = _WIDTH) -> str:
    return "".join(cell.ljust(width) for cell in cells).rstrip()


def _read_rows(text: str) -> list[dict[str, str]]:
    lines = text.splitlines()
    if len(lines) < 4 or not lines[0].startswith("BEGIN ") or lines[-1] != "[END]":
        raise BadInput("a table begins with BEGIN and ends with [END]")
    head = lines[1].split()
    return [dict(zip(head, line.split(), strict=True)) for line in lines[2:-1]]


def _read_columns(
    axis: str, rows: list[dict[str, str]], reading: str
) -> Iterator[InterpolatedTable]:
    columns = {
        n: np.array([float(row[n]) for row in rows])
        for n in rows[0]
        if n in (*LINEAR, "AXISPOS", "BACKLASH")
    }
    at, back = columns["AXISPOS"], columns.get("BACKLASH")
    for out, name in enumerate(LINEAR):
        value = columns[name]
        if name != axis or back is None:
            yield InterpolatedTable(axis, out, at, -value)
        elif reading == "difference":
            yield InterpolatedTable(axis, out, at, -value, -value - back)
        else:
            yield InterpolatedTable(axis, out, at, -value, -back)
