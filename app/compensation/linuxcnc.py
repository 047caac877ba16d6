"""LinuxCNC: a `COMP_FILE` a joint, type 0.

Rows `nominal forward reverse`, ascending, joint units, at most 256; columns 2 and 3 are
the positions reached, and the controller sends the motor to command + nominal − column.
No header and no comment: the loader stops silently at the first line that is not
three numbers. Source: LinuxCNC `src/emc/motion/usrmotintf.cc`, `control.c`.
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


class LinuxCnc(TableFormat):
    """One table a straight axis, both directions."""

    control = "LinuxCNC"
    suffix = ".tbl"
    most_points = 256
    carries = "positioning of each axis, forward and reverse"
    not_carried = "straightness, angular errors, squareness"
    sign = "columns 2 and 3 are positions reached: nominal + error (COMP_FILE_TYPE = 0)"
    sign_is_verified = True
    note = (
        "name each file as COMP_FILE of its [JOINT_n], with COMP_FILE_TYPE = 0; the "
        "tables are read when LinuxCNC starts, and replace BACKLASH"
    )

    def write(self, content: CompensationTables) -> dict[str, str]:
        """Return a table a straight axis, `STEM-X.tbl`."""
        return {
            f"{content.stem}-{table.axis.name}{self.suffix}": _write_rows(table)
            for table in content.tables
        }

    def read_tables(
        self, files: Mapping[str, str], machine: Machine
    ) -> Iterator[InterpolatedTable]:
        """Yield the trims that the controller adds."""
        for name, text in files.items():
            yield _read_table(name, text, self.suffix)


def _write_rows(table: AxisTable) -> str:
    at, own = table.position_mm, table.own
    forward, backward = at + table.forward_mm[:, own], at + table.backward_mm[:, own]
    return "".join(
        f"{a:.6f} {f:.6f} {b:.6f}\n"
        for a, f, b in zip(at, forward, backward, strict=True)
    )


def _read_table(name: str, text: str, suffix: str) -> InterpolatedTable:
    """Return the trims of an axis, whose name ends that of the file."""
    rows: list[list[float]] = []
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split()
        if len(words) != 3:
            raise BadInput(f"{name}, row {number}: a row has three numbers")
        rows.append([float(word) for word in words])
    nominal, forward, reverse = np.array(rows).T
    if len(rows) > 256 or (np.diff(nominal) <= 0).any():
        raise BadInput(f"{name}: 256 rows at most, ascending")
    axis = name.removesuffix(suffix)[-1]
    out = LINEAR.index(axis)
    return InterpolatedTable(axis, out, nominal, nominal - forward, nominal - reverse)
