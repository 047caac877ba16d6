"""Heidenhain: a `.com` table per axis, activated by the `.cma` table.

[axis of the column] = F(axis in whose column of the .cma the table is named). Values
are those of the error curve and are subtracted. Whether BACKLASH holds the value in
negative travel or what is added there is an option: "the compensation values measured
in the negative direction". Sources: MANUALplus 620 Technical Manual, pages 716 to 718;
TNC 407 Technical Manual, pages 152 and 153.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import PurePath

import numpy as np

from truepath_simulators.compensation.correction import Curve, Rules, Term
from truepath_simulators.errors import SimulatorError
from truepath_simulators.machine_file import MachineFile

Columns = dict[str, list[str]]


def read_heidenhain(
    files: Mapping[str, str], machine: MachineFile, rules: Rules
) -> Iterator[Term]:
    """Corrections by the tables in the active line of the .cma file."""
    names = [name for name in files if name.lower().endswith(".cma")]
    if len(names) != 1:
        raise SimulatorError("one .cma file says which .com tables are active")
    config = _read_columns(names[0], files[names[0]])
    active = [k for k, mark in enumerate(config.get("ACTIVE", [])) if mark == "*"]
    if len(active) != 1:
        raise SimulatorError(f"{names[0]}: one line is active, by * in ACTIVE")
    tables = {PurePath(name).name: text for name, text in files.items()}
    for axis in machine.axis_names:
        table = config.get(axis, [""] * (active[0] + 1))[active[0]]
        if not table or table == "-":
            continue
        if table not in tables:
            raise SimulatorError(f"{names[0]}: the table {table} is not there")
        yield from _read_table(table, tables[table], axis, machine, rules)


def _read_table(
    name: str, text: str, axis: str, machine: MachineFile, rules: Rules
) -> Iterator[Term]:
    columns = _read_columns(name, text)
    at = np.array(columns["AXISPOS"], float)
    own = machine.axis_names.index(axis)
    for out, letter in enumerate(machine.axis_names):
        if letter not in columns:
            continue
        value = -np.array(columns[letter], float)
        if out != own or "BACKLASH" not in columns:
            yield Term(out, (Curve(own, at, value),))
            continue
        back = -np.array(columns["BACKLASH"], float)
        if rules.backlash_reading == "difference":
            back = value + back
        yield Term(own, (Curve(own, at, value, 1),))
        yield Term(own, (Curve(own, at, back, -1),))


def _read_columns(name: str, text: str) -> Columns:
    lines = [line for line in text.splitlines() if not line.startswith(("#", ";"))]
    if len(lines) < 4 or not lines[0].startswith("BEGIN") or lines[-1] != "[END]":
        raise SimulatorError(f"{name}: a table stands between BEGIN and [END]")
    head, *rows = [line.split() for line in lines[1:-1]]
    for number, row in enumerate(rows):
        if len(row) != len(head):
            raise SimulatorError(f"{name}, NR {number}: {len(head)} columns, {row}")
    return {word: [row[k] for row in rows] for k, word in enumerate(head)}
