"""SINUMERIK `$TC_CARR`: locations of the rotary axes, as a swivel data set.

A table (type P) moves a point w of the workpiece by what l2 + R1 (l3 + R2 (l4 + w)) is
more than at zero, a head (T) its tool t by l1 + R1 (l2 + R2 (l3 + t)); of one of each
(M) the head is l1 + R1 (l2 + t), the table l3 + R2 (l4 + w). R turns right-handed about
v by the angle of the axis, and the second axis stands on the first. Chains are written
closed: at zero nothing is moved. Swivel cycles use it (CYCLE800), and transformation
type 72 for motion of five axes.

Source: SINUMERIK Operate commissioning manual 12/2017, 6FC5397-1DP40-6BA1, swivelling,
pages 566, 572 and 586; 03/2013, page 502; Function Manual Tool Compensation (W1)
08/2005, pages 2-92, 2-98 (a table whose axis points in +Y, at +45 degrees), 2-100 and
4-3 (l4 of 15 mm in Z, B at 45 degrees: the zero point moves by X 10.607, Z -4.393).
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from truepath.compensation.rotary_tables import (
    RotaryAxisLocation,
    list_stated_locations,
)
from truepath.errors import BadInput
from truepath.kinematics.machine.machine import (
    Machine,
    RotaryAxis,
    compute_local_directions,
)
from truepath.kinematics.machine.symbols import LINEAR, TURNS, list_locations

SWIVEL = "-swivel.mpf"
ABOUT_SWIVEL = (
    "swivel data set 1: write the number of yours (never 0) for the [1] of each line,",
    "and keep a copy of it; run with CYCLE800(), TCARR=0 and TRAFOOF; it acts at once",
    "compare first: l differ from yours by tenths of a mm (along its own axis a point",
    "is free), v by a thousandth and in no sign; else do not run it",
    "chains close: l1+l2+l3 of a head, l2+l3+l4 of a table, l1+l2 and l3+l4 of both",
    "are 0; a set of yours that does not close, of a head or table that is changed,",
    "is not to be replaced",
    "$TC_CARR24, 25, 41 to 46, 55 to 60, 64 and 65 are to be 0: they would be added",
    "mm from the zero of the machine axes, as right as the offset of the first target",
    "from the nose of the spindle is known, which is in each l: enter it measured, in",
    "all three directions",
    "v have the sign with which the path was measured: angles count right-handed about",
    "them, of a table as it turns the workpiece",
    "trial: probe the centre of a ball at two angles of each axis, with a probe whose",
    "length is known, before and after: the centres differ less; if they differ more,",
    "the offset of the target is the first suspect",
)
_FIRST = {"l1": 1, "l2": 4, "v1": 7, "v2": 10, "l3": 15, "l4": 18}
_USED: Mapping[str, tuple[str, ...]] = {
    "P": ("l2", "l3", "l4"),
    "T": ("l1", "l2", "l3"),
    "M": ("l1", "l2", "l3", "l4"),
}
_SETTING = re.compile(
    r"(?:N\d+\s*)?\$TC_CARR(\d+)\s*\[\s*(\d+)\s*\]\s*=\s*([-+]?\d+(?:\.\d*)?)",
    re.IGNORECASE,
)
_ENDS = ("M30", "M17", "M2", "M02")
_CLOSED_MM = 5e-6  # rounding of three values
_SAME = 0.9  # cosine: an axis that is tilted more is another one

Vectors = Mapping[str, Float64[np.ndarray, "3"]]


@dataclass(frozen=True, slots=True)
class SwivelKind:
    """Sides that turn: `P` the workpiece, `T` the tool, `M` both.

    axes : one or two; the second stands on the first, of both kinds the head is first
    """

    letter: str
    axes: tuple[RotaryAxis, ...]

    @property
    def used(self) -> tuple[str, ...]:
        """Names of the vectors of such a machine; v2 is 0 where one axis turns."""
        return (*_USED[self.letter], "v1", "v2")


def find_swivel_kind(machine: Machine) -> SwivelKind | None:
    """None for a machine that no swivel data set describes.

    One or two rotary axes, no linear axis between them and workpiece or tool.
    """
    table = _list_rotary(machine, machine.workpiece_side)[::-1]
    head = _list_rotary(machine, machine.tool_side)
    count = len(table) + len(head)
    nearest = len(machine.tool_side) - len(head)
    beside = machine.workpiece_side[: len(table)] + machine.tool_side[nearest:]
    if count not in (1, 2) or sum(name in TURNS for name in beside) < count:
        return None
    letter = "M" if table and head else "P" if table else "T"
    return SwivelKind(letter, (*head, *table))


def list_swivel_locations(
    machine: Machine, places: Sequence[RotaryAxisLocation]
) -> frozenset[str]:
    """Locations that the data set contains, of those in the result.

    None where no data set describes the machine, or where one of its axes is unknown:
    vectors of the drawing must not replace any in the control.
    """
    if find_swivel_kind(machine) is None or not all(one.known for one in places):
        return frozenset()
    return list_stated_locations(places)


def write_swivel(
    machine: Machine, places: Sequence[RotaryAxisLocation]
) -> Iterator[str]:
    """Lines that set the vectors; none where nothing of them was measured."""
    kind = find_swivel_kind(machine)
    if kind is None or not list_swivel_locations(machine, places):
        return
    by_name = {place.axis.name: place for place in places}
    chosen = [by_name[axis.name] for axis in kind.axes]
    turned = " and ".join(axis.name for axis in kind.axes)
    yield f'; $TC_CARR23[1] is to be "{kind.letter}", the axes {turned} in this order'
    every = {symbol for axis in kind.axes for symbol in list_locations(axis.name)}
    if unknown := sorted(every.difference(*(place.known for place in chosen))):
        yield f"; not told by the measurement: {', '.join(unknown)}"
    vectors = _find_vectors(kind.letter, [place.origin_mm for place in chosen])
    vectors["v2"] = np.zeros(3)
    vectors |= {f"v{k + 1}": place.direction for k, place in enumerate(chosen)}
    for name in sorted(kind.used, key=lambda one: _FIRST[one]):
        digits = 6 if name[0] == "l" else 9
        for k, value in enumerate(vectors[name]):
            yield f"$TC_CARR{_FIRST[name] + k}[1]={value:z.{digits}f}"


def read_swivel(name: str, text: str, machine: Machine) -> dict[str, float]:
    """Location errors given by the vectors, mm and rad.

    Raises BadInput naming file and row, or the part that does not fit the machine.
    """
    kind = find_swivel_kind(machine)
    if kind is None:
        raise BadInput(f"{name}: no swivel data set describes chain {machine.chain}")
    vectors = _read_vectors(name, text, kind)
    origins = _find_origins(kind.letter, vectors)[: len(kind.axes)]
    closed = _find_vectors(kind.letter, origins)
    if any(np.abs(closed[one] - vectors[one]).max() > _CLOSED_MM for one in closed):
        raise BadInput(f"{name}: the vectors do not close: at zero they move the tool")
    located: dict[str, float] = {}
    for k, (axis, origin) in enumerate(zip(kind.axes, origins, strict=True), 1):
        located |= _find_location(axis, origin, _read_direction(name, axis, vectors, k))
    return located


def _list_rotary(machine: Machine, names: Sequence[str]) -> list[RotaryAxis]:
    return [machine.rotary(name) for name in names if name in TURNS]


def _find_vectors(
    letter: str, origins: Sequence[Float64[np.ndarray, "3"]]
) -> dict[str, Float64[np.ndarray, "3"]]:
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
    """A point of each axis; with one axis alone the second is meaningless."""
    if letter == "P":
        return [vectors["l2"], vectors["l2"] + vectors["l3"]]
    if letter == "T":
        return [vectors["l2"] + vectors["l3"], vectors["l3"]]
    return [vectors["l2"], vectors["l3"]]


def _read_vectors(name: str, text: str, kind: SwivelKind) -> Vectors:
    values = _read_values(name, text)
    places = {one: range(_FIRST[one], _FIRST[one] + 3) for one in kind.used}
    wanted = sorted(place for one in places.values() for place in one)
    if sorted(values) != wanted:
        said = ", ".join(map(str, wanted))
        raise BadInput(f"{name}: chain type {kind.letter} wants $TC_CARR {said}")
    return {one: np.array([values[k] for k in at]) for one, at in places.items()}


def _read_values(name: str, text: str) -> dict[int, float]:
    values: dict[int, float] = {}
    data_set = ""
    for number, line in enumerate(text.splitlines(), 1):
        block = line.partition(";")[0].strip()
        if block.upper() in _ENDS:
            break
        if not block:
            continue
        setting = _SETTING.fullmatch(block)
        if setting is None:
            raise BadInput(f"{name}, row {number}: {block!r} is no $TC_CARR value")
        place, data_set_here = int(setting[1]), setting[2]
        data_set = data_set or data_set_here
        if place in values or data_set_here != data_set:
            raise BadInput(
                f"{name}, row {number}: {block!r} states a value twice, or is of "
                f"another data set than {data_set}"
            )
        values[place] = float(setting[3])
    return values


def _read_direction(
    name: str, axis: RotaryAxis, vectors: Vectors, number: int
) -> Float64[np.ndarray, "3"]:
    vector = vectors[f"v{number}"]
    length = float(np.linalg.norm(vector))
    if length == 0.0 or vector @ np.array(axis.direction) < _SAME * length:
        raise BadInput(
            f"{name}: v{number} is not the direction of {axis.name}, which turns "
            f"right-handed about {', '.join(f'{v:g}' for v in axis.direction)}"
        )
    return vector / length


def _find_location(
    axis: RotaryAxis,
    origin_mm: Float64[np.ndarray, "3"],
    direction: Float64[np.ndarray, "3"],
) -> dict[str, float]:
    own = compute_local_directions(axis).T
    shift = own @ (origin_mm - np.array(axis.origin_mm))
    tilt = own @ np.cross(np.array(axis.direction), direction)
    both = zip(LINEAR + TURNS, [*shift.tolist(), *tilt.tolist()], strict=True)
    found = {f"{letter}O{axis.name}": value for letter, value in both}
    return {symbol: found[symbol] for symbol in list_locations(axis.name)}
