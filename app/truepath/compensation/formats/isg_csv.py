"""ISG kernel and Beckhoff TF5280: volumetric compensation by error motions (ISG_CSV).

Blocks of an argument and the motions of an axis, mm and rad, split by `#`. Squareness
is in the straightness, the target's offset in the displacements, so that lever arms
count from the zero of the axes and the tool length is 0; or that of the tool in use
(`tool_length`). The controller computes the tool point of the chain and subtracts the
error; the sign at the machine has to be tried (it has a switch `negate`). A guide that
bends under another axis has a block of two arguments, the other axis first, on a grid.
Source: ISG kernel manual, volumetric compensation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np
from jaxtyping import Float64

from truepath.compensation.format import (
    CompensationFormat,
    CompensationTables,
    Correction,
)
from truepath.compensation.formats.isg_blocks import (
    interpolate_block,
    read_blocks,
    write_block,
)
from truepath.compensation.formats.isg_rotary import (
    read_places,
    read_rotary_blocks,
    write_rotary_blocks,
)
from truepath.compensation.rotary_tables import (
    RotaryAxisLocation,
    list_stated_locations,
)
from truepath.compensation.tables.motion_correction import correct_by_motions
from truepath.compensation.tables.tool_length import TOOL_SYMBOLS, ToolLength, add_tool
from truepath.errors import BadInput
from truepath.kinematics.machine.machine import Machine


class IsgCsv(CompensationFormat):
    """All error motions of all linear axes, one file."""

    control = "ISG kernel, Beckhoff TF5280"
    suffix = ".csv"
    most_points = 1000
    carries = (
        "all error motions and squareness, with their lever arms in the whole volume; "
        "of each axis what it does with one other one, as sag; rotary axes with their "
        "locations, the position of the tool alone"
    )
    not_carried = "backlash and what depends on direction"
    units = "mm and rad, positions mm"
    composes_rotary = True
    sign = "the file has the errors; the controller takes them away"
    sign_is_verified = False
    choices: ClassVar[Mapping[str, tuple[str, ...]]] = ToolLength.choices

    def __init__(self, tool_length: str = "fixed") -> None:
        self._tool = ToolLength(tool_length)
        self.note = (
            "file_format ISG_CSV, Interpolation GRID, the kinematic chain as it stands "
            f"in the second line; {self._tool.note}. With rotary axes the tip at zero "
            "is in P0X, P0Y, P0Z and the centre of C in PXC, PYC, PZC: try one angle "
            "first"
        )

    def write(self, content: CompensationTables) -> dict[str, str]:
        """One file with a block per axis."""
        lines = [f"// {line}" for line in content.stamp]
        if content.machine.rotary_axes:
            blocks = list(write_rotary_blocks(content, self._tool))
            text = "\n".join([*lines, "\n#\n".join(blocks), ""])
            return {f"{content.stem}{self.suffix}": text}
        tables = self._tool.shorten(content.tables, content.machine)
        blocks: list[str] = []
        if direction := self._tool.find_direction(content.machine):
            numbers = "  ".join(map(str, direction))
            blocks.append("\n".join(["  ".join(TOOL_SYMBOLS), numbers]))
        blocks += ["\n".join(write_block(table)) for table in tables]
        text = "\n".join([*lines, "\n#\n".join(blocks), ""])
        return {f"{content.stem}{self.suffix}": text}

    def read(self, files: Mapping[str, str], machine: Machine) -> Correction:
        """Minus the error of the chain from the motions."""
        (text,) = files.values()
        if machine.rotary_axes:
            return read_rotary_blocks(text, machine)
        blocks = dict(read_blocks(text))
        tool = blocks.pop(" ".join(TOOL_SYMBOLS), ("", np.zeros((1, 3))))[1][0]
        if unknown := [name for name in blocks if name not in machine.axis_names]:
            raise BadInput(f"no axis of the machine has the parameter {unknown[0]}")

        def find_motion(
            axis: str, position_mm: Float64[np.ndarray, "n a"], direction: float
        ) -> Float64[np.ndarray, "n 6"]:
            motion = interpolate_block(blocks, axis, position_mm, machine)
            return add_tool(motion, tool, machine)

        return correct_by_motions(machine, blocks, find_motion)

    def list_written_locations(
        self, machine: Machine, places: Sequence[RotaryAxisLocation]
    ) -> frozenset[str]:
        """All locations that the result has."""
        del machine
        return list_stated_locations(places)

    def read_locations(
        self, files: Mapping[str, str], machine: Machine
    ) -> dict[str, float]:
        """Locations of rotary axes among the constants, mm and rad."""
        (text,) = files.values()
        return read_places(text) if machine.rotary_axes else {}
