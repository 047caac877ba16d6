"""LinuxCNC: a `COMP_FILE` of type 0 a joint.

Rows `nominal forward reverse`; the loader keeps nominal − column as trim and adds it.
Source: `src/emc/motion/usrmotintf.cc`, `control.c`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np

from truepath.simulators.compensation.correction import Curve, Term
from truepath.simulators.errors import SimulatorError
from truepath.simulators.machine_file import MachineFile

_MOST_ROWS = 256
_AXIS = re.compile(r"(?:^|[-_.])([XYZABC])\.\w+$", re.IGNORECASE)


def read_linuxcnc(name: str, text: str, machine: MachineFile) -> Iterator[Term]:
    """Yield the trims of the joint whose letter ends the name, as in `comp-X.tbl`."""
    letter = _AXIS.search(name)
    axis = letter.group(1).upper() if letter else ""
    if axis not in machine.axis_names:
        raise SimulatorError(
            f"{name}: the name does not end in an axis of the machine, as comp-X.tbl"
        )
    column = machine.axis_names.index(axis)
    nominal, forward, reverse = _read_rows(name, text).T
    for side, reached in ((1, forward), (-1, reverse)):
        yield Term(column, (Curve(column, nominal, nominal - reached, side),))


def _read_rows(name: str, text: str) -> np.ndarray:
    rows: list[list[float]] = []
    for number, line in enumerate(text.splitlines(), 1):
        try:
            first, second, third = map(float, line.split())
        except ValueError as error:
            raise SimulatorError(
                f"{name}, row {number}: not three numbers; LinuxCNC would stop there "
                "without a word"
            ) from error
        rows.append([first, second, third])
    table = np.array(rows).reshape(-1, 3)
    if not 0 < len(table) <= _MOST_ROWS or (np.diff(table[:, 0]) <= 0.0).any():
        raise SimulatorError(f"{name}: 1 to {_MOST_ROWS} rows, ascending")
    return table
