"""SINUMERIK `$TC_CARR`: where the rotary axes are, as a swivel data set.

A table (type P) brings a point w of the workpiece to l2 + R1 (l3 + R2 (l4 + w)), a head
(T) its tool t to l1 + R1 (l2 + R2 (l3 + t)); of one of each (M) the head is l1 + R1 (l2
+ t), the table l3 + R2 (l4 + w). R turns right-handed about v by the angle of the axis,
and the second axis stands on the first. Chains close: at zero nothing is moved. Swivel
cycles use it (CYCLE800), and transformation type 72 for motion of five axes.

Source: SINUMERIK Operate commissioning manual 12/2017, 6FC5397-1DP40-6BA1, swivelling,
pages 572 and 586; 03/2013, page 502; Function Manual Tool Compensation (W1) 08/2005,
pages 2-98 (a table whose axis points in +Y, at +45 degrees) and 4-3 (l4 of 15 mm in Z,
B at 45 degrees: the zero point moves by X 10.607, Z -4.393).
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from truepath.app.compensation.rotary_tables import AxisPlace
from truepath.app.errors import BadInput
from truepath.app.kinematics.machine import Machine, RotaryAxis, find_local_directions
from truepath.app.kinematics.symbols import LINEAR, TURNS, list_locations

SWIVEL = "-swivel.mpf"
_FIRST = {"l1": 1, "l2": 4, "v1": 7, "v2": 10, "l3": 15, "l4": 18}
_USED: Mapping[str, tuple[str, ...]] = {
    "P": ("l2", "l3", "l4"),
    "T": ("l1", "l2", "l3"),
    "M": ("l1", "l2", "l3", "l4"),
}
_SETTING = re.compile(r"\$TC_CARR(\d+)\[1\]=(-?\d+\.\d+)")
_CLOSED_MM = 5e-6  # rounding of three values

Vectors = Mapping[str, Float64[np.ndarray, "3"]]


@dataclass(frozen=True, slots=True)
class SwivelKind:
    """What turns: `P` the workpiece, `T` the tool, `M` both.

    axes : one or two; the second stands on the first, of both kinds the head is first
    """

    letter: str
    axes: tuple[RotaryAxis, ...]

    @property
    def used(self) -> tuple[str, ...]:
        """Names of the vectors of such a machine."""
        return (*_USED[self.letter], *(f"v{k + 1}" for k in range(len(self.axes))))


def find_swivel_kind(machine: Machine) -> SwivelKind | None:
    """Return what turns; None of a machine that no swivel data set describes.

    One or two rotary axes, no straight axis between them and workpiece or tool.
    """
    table = _list_rotary(machine, machine.workpiece_side)[::-1]
    head = _list_rotary(machine, machine.tool_side)
    count = len(table) + len(head)
    beside = machine.workpiece_side[: len(table)] + machine.tool_side[-len(head) :]
    if count not in (1, 2) or sum(name in TURNS for name in beside) < count:
        return None
    letter = "M" if table and head else "P" if table else "T"
    return SwivelKind(letter, (*head, *table))


def write_swivel(machine: Machine, places: tuple[AxisPlace, ...]) -> Iterator[str]:
    """Yield the lines that set the vectors; nothing where no data set has them."""
    kind = find_swivel_kind(machine)
    if kind is None:
        return
    by_name = {place.axis.name: place for place in places}
    chosen = [by_name[axis.name] for axis in kind.axes]
    turned = " and ".join(axis.name for axis in kind.axes)
    yield f'; $TC_CARR23[1] is to be "{kind.letter}", the axes {turned} in this order'
    vectors = _find_vectors(kind.letter, [place.origin_mm for place in chosen])
    vectors |= {f"v{k + 1}": place.direction for k, place in enumerate(chosen)}
    for name in sorted(kind.used, key=lambda one: _FIRST[one]):
        digits = 6 if name[0] == "l" else 9
        for k, value in enumerate(vectors[name]):
            yield f"$TC_CARR{_FIRST[name] + k}[1]={value:z.{digits}f}"


def read_swivel(name: str, text: str, machine: Machine) -> dict[str, float]:
    """Return the location errors that the vectors stand for, mm and rad.

    Raises BadInput naming file and row, or what does not belong to the machine.
    """
    kind = find_swivel_kind(machine)
    if kind is None:
        raise BadInput(f"{name}: no swivel data set describes chain {machine.chain}")
    vectors = _read_vectors(name, text, kind)
    origins = _find_origins(kind.letter, vectors)
    closed = _find_vectors(kind.letter, origins)
    if any(np.abs(closed[one] - vectors[one]).max() > _CLOSED_MM for one in closed):
        raise BadInput(f"{name}: the vectors do not close: at zero they move the tool")
    located: dict[str, float] = {}
    for k, (axis, origin) in enumerate(zip(kind.axes, origins, strict=True), 1):
        located |= _find_location(axis, origin, vectors[f"v{k}"])
    return located


def _list_rotary(machine: Machine, names: Sequence[str]) -> list[RotaryAxis]:
    return [machine.rotary(name) for name in names if name in TURNS]


def _find_vectors(
    letter: str, origins: Sequence[Float64[np.ndarray, "3"]]
) -> dict[str, Float64[np.ndarray, "3"]]:
    """Return the vectors of a chain through the axes that closes."""
    first, last = origins[0], origins[-1]
    if letter == "P":
        return {"l2": first, "l3": last - first, "l4": -last}
    if letter == "T":
        # From the tool's seat to the second axis, to the first, and back. Of one axis
        # alone the first vector is empty.
        nearer = last if len(origins) == 2 else np.zeros(3)
        return {"l1": -first, "l2": first - nearer, "l3": nearer}
    return {"l1": -first, "l2": first, "l3": last, "l4": -last}


def _find_origins(letter: str, vectors: Vectors) -> list[Float64[np.ndarray, "3"]]:
    """Return a point of each axis; of one axis alone the second is of none."""
    if letter == "P":
        return [vectors["l2"], vectors["l2"] + vectors["l3"]][: _count(vectors)]
    if letter == "T":
        return [vectors["l2"] + vectors["l3"], vectors["l3"]][: _count(vectors)]
    return [vectors["l2"], vectors["l3"]]


def _count(vectors: Vectors) -> int:
    return 1 + ("v2" in vectors)


def _read_vectors(name: str, text: str, kind: SwivelKind) -> Vectors:
    values: dict[int, float] = {}
    for number, line in enumerate(text.splitlines(), 1):
        block = line.partition(";")[0].strip()
        if not block.startswith("$"):
            continue
        setting = _SETTING.fullmatch(block)
        if setting is None:
            raise BadInput(f"{name}, row {number}: {block!r} is no $TC_CARR value")
        values[int(setting[1])] = float(setting[2])
    places = {one: range(_FIRST[one], _FIRST[one] + 3) for one in kind.used}
    wanted = sorted(place for one in places.values() for place in one)
    if sorted(values) != wanted:
        said = ", ".join(map(str, wanted))
        raise BadInput(f"{name}: chain type {kind.letter} wants $TC_CARR {said}")
    return {one: np.array([values[k] for k in at]) for one, at in places.items()}


def _find_location(
    axis: RotaryAxis,
    origin_mm: Float64[np.ndarray, "3"],
    direction: Float64[np.ndarray, "3"],
) -> dict[str, float]:
    own = find_local_directions(axis).T
    shift = own @ (origin_mm - np.array(axis.origin_mm))
    tilt = own @ np.cross(np.array(axis.direction), direction)
    both = zip(LINEAR + TURNS, np.concatenate([shift, tilt]), strict=True)
    told = {f"{letter}O{axis.name}": float(value) for letter, value in both}
    return {symbol: told[symbol] for symbol in list_locations(axis.name)}
