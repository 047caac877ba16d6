"""SINUMERIK: a swivel data set, as used by a program of five axes.

A program names the position of the tool's tip on the workpiece. With the vectors of the
machine as built the linear axes would reach the commanded positions; with those of a
file they reach others. The tool is entered with all three lengths of the target.

Source: Function Manual Tool Compensation (W1) 08/2005, 2.5 and page 4-3, where l4 = (0,
0, 15) of a table moves the zero point by X 10.607, Z -4.393 at B 45.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from truepath_simulators.compensation.correction import Correction
from truepath_simulators.errors import SimulatorError
from truepath_simulators.machine_file import MachineFile, RotaryAxis

_LINE = re.compile(
    r"(?:N\d+\s*)?\$TC_CARR(\d+)\s*\[\s*\d+\s*\]\s*=\s*([-+]?[\d.]+)", re.IGNORECASE
)
_NOTHING = np.zeros(3)


@dataclass(frozen=True, slots=True)
class Link:
    """A rotary axis: v and the column of its angle."""

    column: int
    direction: np.ndarray

    def turn(self, position: np.ndarray) -> Rotation:
        """Rotation at each position."""
        angle = np.radians(position[:, self.column])
        return Rotation.from_rotvec(angle[:, None] * self.direction)


@dataclass(frozen=True, slots=True)
class Chain:
    """One side of the machine: `offsets` before, between and after its links."""

    links: tuple[Link, ...]
    offsets: tuple[np.ndarray, ...]

    def apply(self, position: np.ndarray, point: np.ndarray) -> np.ndarray:
        """Point carried outwards: l + R (l + R (l + point))."""
        carried = point + self.offsets[-1]
        for link, offset in zip(self.links[::-1], self.offsets[-2::-1], strict=True):
            carried = link.turn(position).apply(carried) + offset
        return carried

    def undo(self, position: np.ndarray, point: np.ndarray) -> np.ndarray:
        """Inverse of `apply`."""
        carried = point - self.offsets[0]
        for link, offset in zip(self.links, self.offsets[1:], strict=True):
            carried = link.turn(position).inv().apply(carried) - offset
        return carried


@dataclass(frozen=True, slots=True)
class SwivelCorrection(Correction):
    """Motion of the linear axes due to vectors that differ from the nominal ones.

    straight : columns of X, Y, Z; tool : from its tip to its seat, mm
    nominal, given : chains of the head and of the table
    """

    straight: tuple[int, ...]
    tool: np.ndarray
    nominal: tuple[Chain, Chain]
    given: tuple[Chain, Chain]

    def added(self, position: np.ndarray, heading: np.ndarray) -> np.ndarray:
        """Addition in mm; 0 for rotary axes."""
        del heading
        tool = np.tile(self.tool, (len(position), 1))
        head, table = self.nominal
        at = position[:, self.straight]
        on_table = table.undo(position, at - head.apply(position, tool))
        head, table = self.given
        sent = table.apply(position, on_table) + head.apply(position, tool)
        total = np.zeros_like(position, dtype=float)
        total[:, self.straight] = sent - at
        return total


def is_swivel(text: str) -> bool:
    """Whether a file sets a swivel data set."""
    return _LINE.search(text) is not None


def read_swivel(name: str, text: str, machine: MachineFile) -> SwivelCorrection:
    """Correction by the vectors. Raises SimulatorError."""
    values = _collect(name, text)
    head = [a for a in machine.rotary_axes if a.name in machine.tool_side]
    table = [a for a in machine.rotary_axes if a.name in machine.workpiece_side]
    head.sort(key=lambda axis: machine.tool_side.index(axis.name))
    table.sort(key=lambda axis: -machine.workpiece_side.index(axis.name))
    if len(head) + len(table) > 2:
        raise SimulatorError(f"{name}: a swivel data set has two rotary axes")
    names = machine.axis_names
    given = _read_chains(
        [names.index(axis.name) for axis in head],
        [names.index(axis.name) for axis in table],
        values,
    )
    nominal = _Built(machine).chain(head, is_head=True), _Built(machine).chain(table)
    straight = tuple(names.index(letter) for letter in "XYZ")
    tool = -np.array(machine.reflector().offset_mm, float)
    return SwivelCorrection(straight, tool, nominal, given)


@dataclass(frozen=True, slots=True)
class _Built:
    machine: MachineFile

    def chain(self, axes: list[RotaryAxis], *, is_head: bool = False) -> Chain:
        """The outermost axis first."""
        names = self.machine.axis_names
        points = [np.array(axis.origin_mm, float) for axis in axes]
        if is_head:
            points = [-point for point in points]
        stations = [_NOTHING, *points, _NOTHING]
        steps = [b - a for a, b in pairwise(stations)]
        links = [
            Link(names.index(axis.name), np.array(axis.direction, float))
            for axis in axes
        ]
        return Chain(tuple(links), tuple(steps))


def _read_chains(
    head: list[int], table: list[int], values: dict[int, float]
) -> tuple[Chain, Chain]:
    l1, l2, v1, v2, l3, l4 = (
        np.array([values.get(first + k, 0.0) for k in range(3)])
        for first in (1, 4, 7, 10, 15, 18)
    )
    empty = Chain((), (_NOTHING,))
    columns = head + table
    if any(not v.any() for v, _ in zip((v1, v2), columns, strict=False)):
        raise SimulatorError("a swivel data set has a direction for each axis")
    links = tuple(
        Link(column, v / np.linalg.norm(v))
        for column, v in zip(columns, (v1, v2), strict=False)
    )
    one = len(columns) == 1  # the second turn is none
    if head and table:
        return Chain(links[:1], (l1, l2)), Chain(links[1:], (l3, l4))
    if table:
        return empty, Chain(links, (l2, l3 + l4) if one else (l2, l3, l4))
    return Chain(links, (l1, l2 + l3) if one else (l1, l2, l3)), empty


def _collect(name: str, text: str) -> dict[int, float]:
    values: dict[int, float] = {}
    for number, line in enumerate(text.splitlines(), 1):
        block = line.partition(";")[0].strip()
        if block == "M30":
            break
        if not block:
            continue
        found = _LINE.fullmatch(block)
        if found is None:
            raise SimulatorError(f"{name}, row {number}: {block!r} is not understood")
        values[int(found[1])] = float(found[2])
    return values
