"""ISG kernel and Beckhoff TF5280: volumetric compensation by error motions (ISG_CSV).

Blocks of an argument and the motions of an axis, mm and rad, split by `#`. Squareness
is in the straightness, the target's offset in the displacements, so that lever arms
count from the zero of the axes and the tool length is 0; or that of the tool in use
(`tool_length`). The controller computes the
tool point of the chain and takes the error away; the sign at the machine has to be
tried (it has a switch `negate`). A guide that bends under another axis has a block of
two arguments, the other axis first, on a grid. Source: ISG kernel manual, volumetric
compensation.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import ClassVar

import numpy as np
from jaxtyping import Float64

from truepath.app.compensation.format import (
    AxisTable,
    CompensationFormat,
    CompensationTables,
    Correction,
)
from truepath.app.compensation.motion_correction import (
    correct_by_motions,
    interpolate_rows,
)
from truepath.app.compensation.tool_length import TOOL_SYMBOLS, ToolLength, add_tool
from truepath.app.errors import BadInput
from truepath.app.kinematics.machine import Machine
from truepath.app.kinematics.symbols import LINEAR, is_turn, list_error_motions


class IsgCsv(CompensationFormat):
    """All error motions of all straight axes, one file."""

    control = "ISG kernel, Beckhoff TF5280"
    suffix = ".csv"
    most_points = 1000
    carries = (
        "all error motions and squareness, with their lever arms in the whole volume; "
        "of each axis what it does with one other one, as sag"
    )
    not_carried = "backlash and what depends on direction"
    units = "mm and rad, positions mm"
    sign = "the file has the errors; the controller takes them away"
    sign_is_verified = False
    choices: ClassVar[Mapping[str, tuple[str, ...]]] = ToolLength.choices

    def __init__(self, tool_length: str = "fixed") -> None:
        self._tool = ToolLength(tool_length)
        self.note = (
            "file_format ISG_CSV, Interpolation GRID, the kinematic chain as it stands "
            f"in the second line; {self._tool.note}"
        )

    def write(self, content: CompensationTables) -> dict[str, str]:
        """Return one file with a block an axis."""
        lines = [f"// {line}" for line in content.stamp]
        tables = self._tool.shorten(content.tables, content.machine)
        blocks: list[str] = []
        if direction := self._tool.find_direction(content.machine):
            numbers = "  ".join(map(str, direction))
            blocks.append("\n".join(["  ".join(TOOL_SYMBOLS), numbers]))
        blocks += ["\n".join(_write_block(table)) for table in tables]
        text = "\n".join([*lines, "\n#\n".join(blocks), ""])
        return {f"{content.stem}{self.suffix}": text}

    def read(self, files: Mapping[str, str], machine: Machine) -> Correction:
        """Return minus the error that the chain makes of the motions."""
        (text,) = files.values()
        blocks = dict(_read_blocks(text))
        tool = blocks.pop(TOOL_SYMBOLS[0], ("", np.zeros((1, 3))))[1][0]

        def find_motion(
            axis: str, position_mm: Float64[np.ndarray, "n a"], direction: float
        ) -> Float64[np.ndarray, "n 6"]:
            at = position_mm[:, machine.axis_names.index(axis)]
            by, rows = blocks[axis]
            if by:
                other = position_mm[:, machine.axis_names.index(by)]
                motion = _interpolate_grid(rows, other, at)
            else:
                motion = interpolate_rows(rows, at)
            return add_tool(motion, tool, machine)

        return correct_by_motions(machine, blocks, find_motion)


def _write_block(table: AxisTable) -> Iterator[str]:
    symbols, pair = list_error_motions(table.axis.name), table.pair
    motions = np.hstack([table.translation_mm, table.rotation_rad])
    if pair is None:
        yield "  ".join([table.axis.name, *symbols])
        yield from _write_rows(table, motions)
        return
    yield "  ".join([pair.by.name, table.axis.name, *symbols])
    for by, error in zip(pair.by_mm, pair.error_mm, strict=True):
        total = motions + np.hstack([error, np.zeros_like(error)])
        yield from (f"{by:.6f}  {row}" for row in _write_rows(table, total))


def _write_rows(table: AxisTable, motions: Float64[np.ndarray, "n 6"]) -> Iterator[str]:
    symbols = list_error_motions(table.axis.name)
    for at, row in zip(table.position_mm, motions, strict=True):
        values = zip(symbols, row, strict=True)
        numbers = [format_motion(symbol, value) for symbol, value in values]
        yield "  ".join([f"{at:.6f}", *numbers])


def format_motion(symbol: str, value: float) -> str:
    """Return mm or rad as the control reads them, to a nanometre and a nanoradian."""
    return f"{value:z.9f}" if is_turn(symbol) else f"{value:z.6f}"


def _interpolate_grid(
    table: Float64[np.ndarray, "r 8"],
    by_mm: Float64[np.ndarray, " n"],
    at_mm: Float64[np.ndarray, " n"],
) -> Float64[np.ndarray, "n 6"]:
    """Return the motions between the four neighbours on the grid."""
    places = np.unique(table[:, 0])
    lines = [
        interpolate_rows(table[table[:, 0] == place, 1:], at_mm) for place in places
    ]
    high = np.clip(np.searchsorted(places, by_mm), 1, len(places) - 1)
    share = (by_mm - places[high - 1]) / (places[high] - places[high - 1])
    share = np.clip(share, 0.0, 1.0)[:, None]
    each, n = np.stack(lines), np.arange(len(at_mm))
    return (1.0 - share) * each[high - 1, n] + share * each[high, n]


def _read_blocks(
    text: str,
) -> Iterator[tuple[str, tuple[str, Float64[np.ndarray, "r c"]]]]:
    """Yield (axis, (second axis, rows of positions and six motions)) of each block.

    The second axis is empty for a block of one argument.
    """
    lines = [line for line in text.splitlines() if not line.startswith("//")]
    for block in "\n".join(lines).split("#"):
        head, *rows = [line.split() for line in block.splitlines() if line.strip()]
        by = head.pop(0) if len(head) > 1 and head[1] in LINEAR else ""
        axis = head[0]
        if tuple(head) == TOOL_SYMBOLS:
            yield axis, ("", np.array([[float(word) for word in rows[0]]]))
            continue
        if head[1:] != list(list_error_motions(axis)):
            raise BadInput(f"the block of {axis} does not have its six motions")
        yield axis, (by, np.array([[float(word) for word in row] for row in rows]))
