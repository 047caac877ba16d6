"""ISG kernel and Beckhoff TF5280: volumetric compensation by error motions (ISG_CSV).

Blocks of an argument and the motions of an axis, mm and rad, split by `#`. Squareness
is in the straightness, the target's offset in the displacements, so that lever arms
count from the zero of the axes and the tool length is 0. The controller computes the
tool point of the chain and takes the error away; the sign at the machine has to be
tried (it has a switch `negate`). Source: ISG kernel manual, volumetric compensation.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import ClassVar

import numpy as np
from jaxtyping import Float64

from app.errors import BadInput
from app.kinematics.machine import Machine
from app.kinematics.symbols import LINEAR, error_motions, is_turn
from app.reporting.compensation.format import CompensationFormat, Correction
from app.reporting.compensation.order import AxisTable, CompensationOrder


class IsgCsv(CompensationFormat):
    """All error motions of all straight axes, one file."""

    control: ClassVar[str] = "ISG kernel, Beckhoff TF5280"
    suffix: ClassVar[str] = ".csv"
    most_points: ClassVar[int] = 1000
    carries: ClassVar[str] = (
        "all error motions and squareness, with their lever arms in the whole volume"
    )
    not_carried: ClassVar[str] = "backlash and what depends on direction"
    sign: ClassVar[str] = "the file has the errors; the controller takes them away"
    sign_is_verified: ClassVar[bool] = False
    note: ClassVar[str] = (
        "file_format ISG_CSV, Interpolation GRID, tool length 0 (N0X, N0Y, N0Z left "
        "out), the kinematic chain as it stands in the first line"
    )

    def write(self, order: CompensationOrder) -> dict[str, str]:
        """Return one file with a block an axis."""
        lines = [f"// {line}" for line in order.stamp]
        blocks = ["\n".join(_block(table)) for table in order.tables]
        text = "\n".join([*lines, "\n#\n".join(blocks), ""])
        return {f"{order.stem}{self.suffix}": text}

    def read(self, files: Mapping[str, str], machine: Machine) -> Correction:
        """Return minus the error that the chain makes of the motions."""
        (text,) = files.values()
        blocks = dict(_parsed(text))

        def correction(
            position_mm: Float64[np.ndarray, "n a"], direction: float
        ) -> Float64[np.ndarray, "n 3"]:
            added = np.zeros((len(position_mm), 3))
            lever = np.zeros((len(position_mm), 3))
            # From the tool to the workpiece: later axes are the lever of earlier ones.
            for axis in reversed([name for name in machine.order if name in LINEAR]):
                at = position_mm[:, machine.axis_names.index(axis)]
                if axis in blocks:
                    motion = _between(blocks[axis], at)
                    added -= motion[:, :3] + np.cross(motion[:, 3:], lever)
                lever[:, LINEAR.index(axis)] += at
            return added

        return correction


def _block(table: AxisTable) -> Iterator[str]:
    symbols = error_motions(table.axis.name)
    yield "  ".join([table.axis.name, *symbols])
    motions = np.hstack([table.shift_mm, table.turn_rad])
    for at, row in zip(table.position_mm, motions, strict=True):
        values = zip(symbols, row, strict=True)
        numbers = [f"{v:z.9f}" if is_turn(s) else f"{v:z.6f}" for s, v in values]
        yield "  ".join([f"{at:.6f}", *numbers])


def _between(
    table: Float64[np.ndarray, "m 7"], at_mm: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, "n 6"]:
    columns = [np.interp(at_mm, table[:, 0], table[:, k]) for k in range(1, 7)]
    return np.stack(columns, axis=1)


def _parsed(text: str) -> Iterator[tuple[str, Float64[np.ndarray, "n 7"]]]:
    """Yield (axis, rows of position and six motions) of each block."""
    plain = [line for line in text.splitlines() if not line.startswith("//")]
    for block in "\n".join(plain).split("#"):
        head, *rows = [line.split() for line in block.splitlines() if line.strip()]
        axis = head[0]
        if head[1:] != list(error_motions(axis)):
            raise BadInput(f"the block of {axis} does not have its six motions")
        yield axis, np.array([[float(word) for word in row] for row in rows])
