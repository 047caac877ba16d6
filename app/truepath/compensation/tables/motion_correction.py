"""Correction by a controller that knows the chain and its error motions.

Some controls add the length of the tool in use to tables of a tool without length. The
ISG kernel computes with tool length 0 unless N0X, N0Y, N0Z give the unit vector from
the flange to the tip; then it adds the effect of the angles at the end of the tool in
use, and displacements are those of a tool without length: they keep only the part
across that vector. Source: ISG kernel manual, volumetric compensation, tool length.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from typing import ClassVar

import numpy as np
from jaxtyping import Float64

from truepath.compensation.format import AxisTable, Correction
from truepath.kinematics.machine.machine import Machine
from truepath.kinematics.machine.symbols import LINEAR, is_turn

FindMotion = Callable[
    [str, Float64[np.ndarray, "n a"], float], Float64[np.ndarray, "n 6"]
]
"""E (mm) and ω (rad) of an axis at positions of all axes in direction 1 or −1."""
TOOL_SYMBOLS = ("N0X", "N0Y", "N0Z")
_NOTES = {
    "fixed": "tool length 0 (N0X, N0Y, N0Z left out): for the measured tool alone",
    "followed": "N0X, N0Y, N0Z give the tool's direction, along Z: the control adds "
    "the length of the tool in use, counted as the offset in the third line is",
}


def correct_by_motions(
    machine: Machine, axes: Collection[str], find_motion: FindMotion
) -> Correction:
    """Minus the error of the chain from the motions of some axes.

    Squareness is in E, the target's offset too, so that the lever arms of ω are the
    positions of the axes nearer to the tool.
    """

    def correction(
        position_mm: Float64[np.ndarray, "n a"], direction: float
    ) -> Float64[np.ndarray, "n 3"]:
        added = np.zeros((len(position_mm), 3))
        lever = np.zeros((len(position_mm), 3))
        # From the tool to the workpiece: later axes are the lever of earlier ones.
        for axis in reversed([name for name in machine.order if name in LINEAR]):
            if axis in axes:
                motion = find_motion(axis, position_mm, direction)
                added -= motion[:, :3] + np.cross(motion[:, 3:], lever)
            lever[:, LINEAR.index(axis)] += position_mm[
                :, machine.axis_names.index(axis)
            ]
        return added

    return correction


def interpolate_rows(
    table: Float64[np.ndarray, "m 7"], at_mm: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, "n 6"]:
    """Motions linear between rows (position, E, ω); end values hold."""
    columns = [np.interp(at_mm, table[:, 0], table[:, k]) for k in range(1, 7)]
    return np.stack(columns, axis=1)


class ToolLength:
    """Whether tables are of the measured tool alone, or of any along the same line.

    word : of `choices`
    """

    choices: ClassVar[Mapping[str, tuple[str, ...]]] = {"tool_length": tuple(_NOTES)}

    def __init__(self, word: str) -> None:
        self._follows = word == "followed"
        self.note = _NOTES[word]

    def find_direction(self, machine: Machine) -> tuple[int, int, int] | None:
        """N0X, N0Y, N0Z; None where the file has none."""
        if not self._follows:
            return None
        return (0, 0, -1 if compute_tool_mm(machine)[2] < 0.0 else 1)

    def find_tip(self, machine: Machine) -> Float64[np.ndarray, "3"]:
        """P0X, P0Y, P0Z: the tip without the length that the control adds."""
        offset = np.array(machine.target().offset_mm, float)
        return offset - compute_tool_mm(machine) if self._follows else offset

    def shorten(
        self, tables: tuple[AxisTable, ...], machine: Machine
    ) -> tuple[AxisTable, ...]:
        """Tables of a tool without length, if the control adds the length."""
        if not self._follows:
            return tables
        return tuple(remove_tool(table, compute_tool_mm(machine)) for table in tables)


def remove_tool(table: AxisTable, tool_mm: Float64[np.ndarray, "3"]) -> AxisTable:
    """The table with that much of the target's offset in its arm instead of in E."""
    lever = np.cross(table.rotation_rad, tool_mm)
    return replace(table, translation_mm=table.translation_mm - lever)


def compute_tool_mm(machine: Machine) -> Float64[np.ndarray, "3"]:
    """Part of the target's offset along Z, where a tool's length counts."""
    return np.array([0.0, 0.0, machine.target().offset_mm[2]])


def add_tool(
    motion: Float64[np.ndarray, "n 6"],
    direction: Float64[np.ndarray, "3"],
    machine: Machine,
) -> Float64[np.ndarray, "n 6"]:
    """Motions at the end of the measured tool, with the length added by the control.

    direction : N0X, N0Y, N0Z, 0 where the file has none
    """
    tool_mm = abs(compute_tool_mm(machine)[2]) * direction
    reached = motion.copy()
    reached[:, :3] += np.cross(motion[:, 3:], tool_mm)
    return reached


def format_motion(symbol: str, value: float) -> str:
    """In mm or rad as the control reads them, to a nanometre and a nanoradian."""
    return f"{value:z.9f}" if is_turn(symbol) else f"{value:z.6f}"
