"""SINUMERIK: `$AA_ENC_COMP` per axis, `$AN_CEC` between axes, and swivel data sets.

A positive value of `$AA_ENC_COMP` moves the axis in the negative direction; `$AN_CEC`
is taken the same way. A table with `$AN_CEC_MULT_BY_TABLE` n gives its product with the
table of index n − 1, which then gives nothing alone, as in the manual's foundation that
sags: ΔX1 = Z1 β(X1). Between MIN and MAX a value that was not entered is 0. The first
index of `$AA_ENC_COMP` is 0 for measuring system 1, 1 for 2. Source: Function Manual
Extended Functions 03/2013, K3, pages 238 to 252.

A program of five axes names the position of the tool's tip on the workpiece. With the
vectors of the machine as built the linear axes would reach the commanded positions;
with those of a file they reach others. The tool is entered with all three lengths of
the target. Source: Function Manual Tool Compensation (W1) 08/2005, 2.5 and page 4-3,
where l4 = (0, 0, 15) of a table moves the zero point by X 10.607, Z -4.393 at B 45.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from truepath_simulators.compensation.correction import Correction, Curve, Rules, Term
from truepath_simulators.errors import SimulatorError
from truepath_simulators.machine_file import MachineFile, RotaryAxis

_LINE = re.compile(
    r"\$A[AN]_(ENC_COMP|CEC)(_[A-Z_]+)?\[([^\]]+)\]\s*=\s*\(?([^()]+)\)?"
)


@dataclass(slots=True)
class _Table:
    setting: dict[str, str] = field(default_factory=dict)
    value: dict[int, float] = field(default_factory=dict)


def read_siemens(
    name: str, text: str, machine: MachineFile, rules: Rules
) -> Iterator[Term]:
    """Corrections by the tables of an INI file.

    rules : with the active measuring system of the axes. Tables of the other would have
        no effect: they raise SimulatorError.
    """
    leadscrew, cross = _collect(name, text, rules)
    for axis, table in leadscrew.items():
        column = _find_column(name, axis, machine)
        yield Term(column, (_make_curve(name, table, column),), -1.0)
    yield from _multiply(name, cross, machine)


def _collect(
    name: str, text: str, rules: Rules
) -> tuple[dict[str, _Table], dict[int, _Table]]:
    leadscrew: dict[str, _Table] = {}
    cross: dict[int, _Table] = {}
    for number, line in enumerate(text.splitlines(), 1):
        block = line.partition(";")[0].strip()
        if not block.startswith("$"):
            continue
        found = _LINE.fullmatch(block)
        if found is None:
            raise SimulatorError(f"{name}, row {number}: {block!r} is not understood")
        kind, word, index, value = found.groups()
        places = [place.strip() for place in index.split(",")]
        if kind == "ENC_COMP":
            active = rules.find_measuring_system(places[-1].rstrip("0123456789"))
            if places[0] != str(active - 1):
                raise SimulatorError(
                    f"{name}, row {number}: {places[-1]} is controlled by measuring "
                    f"system {active}; a table of the other does nothing"
                )
            table = leadscrew.setdefault(places[-1], _Table())
        else:
            table = cross.setdefault(int(places[0]), _Table())
        if word:
            table.setting[word] = value
        else:
            table.value[int(places[1])] = float(value)
    return leadscrew, cross


def _multiply(
    name: str, cross: Mapping[int, _Table], machine: MachineFile
) -> Iterator[Term]:
    by = {
        t: int(table.setting.get("_MULT_BY_TABLE", "0")) for t, table in cross.items()
    }
    missing = [n for n in by.values() if n and n - 1 not in cross]
    if missing:
        raise SimulatorError(f"{name}: there is no table number {missing[0]}")
    factors = {number - 1 for number in by.values() if number}
    curves = {
        t: _make_curve(
            name, table, _find_column(name, table.setting["_INPUT_AXIS"], machine)
        )
        for t, table in cross.items()
    }
    for t, table in cross.items():
        out = _find_column(name, table.setting["_OUTPUT_AXIS"], machine)
        if by[t]:
            yield Term(out, (curves[t], curves[by[t] - 1]), -1.0)
        elif t not in factors:
            yield Term(out, (curves[t],), -1.0)


def _make_curve(name: str, table: _Table, column: int) -> Curve:
    try:
        low, high, step = (
            float(table.setting[word]) for word in ("_MIN", "_MAX", "_STEP")
        )
    except KeyError as error:
        raise SimulatorError(f"{name}: a table lacks {error.args[0][1:]}") from error
    if step <= 0.0 or high <= low:
        raise SimulatorError(f"{name}: STEP is not above 0, or MAX not above MIN")
    count = round((high - low) / step) + 1
    value = np.array([table.value.get(k, 0.0) for k in range(count)])
    period = high - low if int(table.setting.get("_IS_MODULO", "0")) else 0.0
    side = int(table.setting.get("_DIRECTION", "0"))
    return Curve(column, low + step * np.arange(count), value, side, period)


def _find_column(name: str, word: str, machine: MachineFile) -> int:
    numbered = re.fullmatch(r"AX(\d+)", word)
    if numbered and 1 <= int(numbered.group(1)) <= len(machine.axes):
        return int(numbered.group(1)) - 1
    letter = word.rstrip("0123456789")
    if letter not in machine.axis_names:
        raise SimulatorError(f"{name}: the machine has no axis {word}")
    return machine.axis_names.index(letter)


_SWIVEL_LINE = re.compile(
    r"(?:N\d+\s*)?\$TC_CARR(\d+)\s*\[\s*\d+\s*\]\s*=\s*([-+]?[\d.]+)", re.IGNORECASE
)
_NOTHING = np.zeros(3)


@dataclass(frozen=True, slots=True)
class Link:
    """A rotary axis: v and the column of its angle."""

    column: int
    direction: np.ndarray

    def turn(self, position: np.ndarray) -> Rotation:
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
    return _SWIVEL_LINE.search(text) is not None


def read_swivel(name: str, text: str, machine: MachineFile) -> SwivelCorrection:
    """Correction by the vectors. Raises SimulatorError."""
    values = _collect_vectors(name, text)
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
    nominal = _build_chain(machine, head, -1.0), _build_chain(machine, table, 1.0)
    straight = tuple(names.index(letter) for letter in "XYZ")
    tool = -np.array(machine.reflector().offset_mm, float)
    return SwivelCorrection(straight, tool, nominal, given)


def _build_chain(machine: MachineFile, axes: list[RotaryAxis], sign: float) -> Chain:
    """Chain as built, the outermost axis first; sign : -1 of the head's."""
    points = [sign * np.array(axis.origin_mm, float) for axis in axes]
    steps = [b - a for a, b in pairwise([_NOTHING, *points, _NOTHING])]
    links = [
        Link(machine.axis_names.index(axis.name), np.array(axis.direction, float))
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


def _collect_vectors(name: str, text: str) -> dict[int, float]:
    values: dict[int, float] = {}
    for number, line in enumerate(text.splitlines(), 1):
        block = line.partition(";")[0].strip()
        if block == "M30":
            break
        if not block:
            continue
        found = _SWIVEL_LINE.fullmatch(block)
        if found is None:
            raise SimulatorError(f"{name}, row {number}: {block!r} is not understood")
        values[int(found[1])] = float(found[2])
    return values
