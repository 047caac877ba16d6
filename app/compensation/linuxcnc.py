"""LinuxCNC: a `COMP_FILE` a joint, type 0.

Rows `nominal forward reverse`, ascending, joint units, at most 256; columns 2 and 3 are
the positions reached, and the controller sends the motor to command + nominal − column.
No header and no comment: the loader stops without a word at the first line that is not
three numbers. Source: LinuxCNC `src/emc/motion/usrmotintf.cc`, `control.c`.
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


class LinuxCnc(CompensationFormat):
    """One table a straight axis, both directions."""

    control: ClassVar[str] = "LinuxCNC"
    suffix: ClassVar[str] = ".tbl"
    most_points: ClassVar[int] = 256
    carries: ClassVar[str] = "positioning of each axis, forward and reverse"
    not_carried: ClassVar[str] = "straightness, angular errors, squareness"
    sign: ClassVar[str] = (
        "columns 2 and 3 are positions reached: nominal + error (COMP_FILE_TYPE = 0)"
    )
    sign_is_verified: ClassVar[bool] = True
    note: ClassVar[str] = (
        "name each file as COMP_FILE of its [JOINT_n], with COMP_FILE_TYPE = 0; the "
        "tables are read when LinuxCNC starts, and replace BACKLASH"
    )

    def write(self, order: CompensationOrder) -> dict[str, str]:
        """Return a table a straight axis, `STEM-X.tbl`."""
        return {
            f"{order.stem}-{table.axis.name}{self.suffix}": _rows(table)
            for table in order.tables
        }

    def read(self, files: Mapping[str, str], machine: Machine) -> Correction:
        """Return the trims that the controller adds."""
        trims = {
            name.removesuffix(self.suffix)[-1]: _trim(name, text)
            for name, text in files.items()
        }

        def correction(
            position_mm: Float64[np.ndarray, "n a"], direction: float
        ) -> Float64[np.ndarray, "n 3"]:
            added = np.zeros((len(position_mm), 3))
            for axis, (nominal, forward, reverse) in trims.items():
                at = position_mm[:, machine.axis_names.index(axis)]
                side = forward if direction > 0 else reverse
                added[:, LINEAR.index(axis)] = np.interp(at, nominal, side)
            return added

        return correction


def _rows(table: AxisTable) -> str:
    at, own = table.position_mm, table.own
    forward, backward = at + table.forward_mm[:, own], at + table.backward_mm[:, own]
    return "".join(
        f"{a:.6f} {f:.6f} {b:.6f}\n"
        for a, f, b in zip(at, forward, backward, strict=True)
    )


def _trim(name: str, text: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return nominal positions and the trims of both directions."""
    rows: list[list[float]] = []
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split()
        if len(words) != 3:
            raise BadInput(f"{name}, row {number}: a row has three numbers")
        rows.append([float(word) for word in words])
    nominal, forward, reverse = np.array(rows).T
    if len(rows) > 256 or (np.diff(nominal) <= 0).any():
        raise BadInput(f"{name}: 256 rows at most, ascending")
    return nominal, nominal - forward, nominal - reverse
