"""Etalon Exchange, variant "Vendor", as the ISG kernel and Beckhoff TF5280 read it.

A block a parameter, its name in brackets: `VALUE = number`, or `Gridpoints = {` with a
row of position and value each until `}`; `//` begins a comment. Values are in mm and
rad, positions in mm ("Units of measure": for all file formats of that control). What
the parameters are, and what is in them here, is as in `isg_csv`. Public texts show
tables over one axis alone, so what an axis does with another one is not written.
Source: Beckhoff TF5280 and ISG kernel manual, "Etalon Exchange Format", "Units of
measure", "List of parameters supported".
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import ClassVar

import numpy as np
from jaxtyping import Float64

from truepath.compensation.format import (
    AxisTable,
    CompensationFormat,
    CompensationTables,
    Correction,
    Files,
)
from truepath.compensation.tables.motion_correction import (
    TOOL_SYMBOLS,
    ToolLength,
    add_tool,
    correct_by_motions,
    format_motion,
)
from truepath.errors import BadInput
from truepath.kinematics.machine.machine import Machine
from truepath.kinematics.machine.symbols import list_error_motions

_BLOCK = re.compile(
    r"\s*\[(?P<symbol>\w+)\]\s*"
    r"(?:VALUE\s*=\s*(?P<value>\S+)|Gridpoints\s*=\s*\{(?P<rows>[^{}]*)\})\s*"
)


class EtalonExchange(CompensationFormat):
    """All error motions of all linear axes, one file."""

    control = "Etalon Exchange, for the ISG kernel and Beckhoff TF5280"
    suffix = ".txt"
    most_points = 1000
    carries = (
        "all error motions and squareness, with their lever arms in the whole volume"
    )
    not_carried = (
        "backlash and what depends on direction; what an axis does with another one, "
        "as sag: public texts show tables over one axis alone"
    )
    units = "mm and rad, positions mm"
    sign = "the file has the errors; the controller takes them away"
    sign_is_verified = False
    choices: ClassVar[Mapping[str, tuple[str, ...]]] = ToolLength.choices

    def __init__(self, tool_length: str = "fixed") -> None:
        self._tool = ToolLength(tool_length)
        self.note = (
            "file_format ETALON_EXCHANGE (the variant Vendor), Interpolation GRID, the "
            "kinematic chain as it stands in the second line, max_records not below "
            "the number of rows; public texts have the grammar by example alone: if "
            "the control refuses the file, isg-csv says the same; "
            f"{self._tool.note}"
        )

    def write(self, content: CompensationTables) -> dict[str, str]:
        """One file with a block per parameter."""
        lines = [f"// {line}" for line in content.stamp]
        if direction := self._tool.find_direction(content.machine):
            for symbol, number in zip(TOOL_SYMBOLS, direction, strict=True):
                lines += [f"[{symbol}]", f"VALUE = {number}"]
        for table in self._tool.shorten(content.tables, content.machine):
            lines += _write_axis(table)
        return {f"{content.stem}{self.suffix}": "\n".join([*lines, ""])}

    def read(self, files: Files, machine: Machine) -> Correction:
        """Minus the error of the chain from the motions."""
        ((name, text),) = files.items()
        blocks = dict(_read_blocks(name, text))
        known = {
            symbol for axis in machine.order for symbol in list_error_motions(axis)
        }
        unknown = [one for one in blocks if one not in {*known, *TOOL_SYMBOLS}]
        if unknown:
            raise BadInput(f"{name}: no axis has the parameter {unknown[0]}")
        tool = np.array([blocks.get(s, np.zeros((1, 2)))[0, 1] for s in TOOL_SYMBOLS])

        def find_motion(
            axis: str, position_mm: Float64[np.ndarray, "n a"], direction: float
        ) -> Float64[np.ndarray, "n 6"]:
            at = position_mm[:, machine.axis_names.index(axis)]
            motion = np.zeros((len(at), 6))
            for column, symbol in enumerate(list_error_motions(axis)):
                if symbol in blocks:
                    motion[:, column] = np.interp(at, *blocks[symbol].T)
            return add_tool(motion, tool, machine)

        return correct_by_motions(machine, machine.axis_names, find_motion)


def _write_axis(table: AxisTable) -> Iterator[str]:
    motions = np.hstack([table.translation_mm, table.rotation_rad]).T
    for symbol, values in zip(
        list_error_motions(table.axis.name), motions, strict=True
    ):
        yield f"[{symbol}]"
        yield "Gridpoints = {"
        for at, value in zip(table.position_mm, values, strict=True):
            yield f"  {at:.6f} {format_motion(symbol, value)}"
        yield f"}}  // end of {symbol}"


def _read_blocks(
    name: str, text: str
) -> Iterator[tuple[str, Float64[np.ndarray, "r 2"]]]:
    """(parameter, rows of position and value); a constant is at position 0."""
    bare = "\n".join(line.partition("//")[0] for line in text.splitlines()).strip()
    end = 0
    while end < len(bare):
        block = _BLOCK.match(bare, end)
        if block is None:
            said = bare[end:].strip().partition("\n")[0]
            raise BadInput(
                f"{name}: {said!r} begins no block: [NAME], then VALUE or Gridpoints"
            )
        end = block.end()
        rows = block["rows"].splitlines() if block["value"] is None else []
        words = [row.split() for row in rows if row.strip()] or [["0", block["value"]]]
        yield block["symbol"], _parse_rows(name, block["symbol"], words)


def _parse_rows(
    name: str, symbol: str, words: list[list[str]]
) -> Float64[np.ndarray, "r 2"]:
    try:
        table = np.array([[float(word) for word in row] for row in words])
    except (TypeError, ValueError):
        table = np.zeros((0, 0))
    if table.ndim != 2 or table.shape[1] != 2 or (np.diff(table[:, 0]) <= 0.0).any():
        raise BadInput(f"{name}: {symbol} is to have rows of two numbers, ascending")
    return table
