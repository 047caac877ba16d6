"""Siemens SINUMERIK: leadscrew and cross tables together, with their additions.

Each kind of table contains what the other does not. In addition there are the growth
with temperature, and the locations of rotary axes.

Linear temperature compensation: for an axis at position P the control uses

    ΔK = K0(T) + tanβ(T) (P − P0)

with K0 = SD43900, tanβ = SD43910 (the gradient of the line that the error is taken for)
and P0 = SD43920; MD32750 bit 0 switches K0 on, bit 1 tanβ. The control knows no
temperature: its PLC writes SD43900 and SD43910 as the machine warms. Source: SINUMERIK
Function Manual Extended Functions 03/2013, K3, pages 225 to 228. That a positive ΔK
moves the axis in the negative direction, as in leadscrew tables, is assumed. Tables are
those of the stated temperature, where tanβ is therefore 0.

Locations of the rotary axes are a swivel data set, `$TC_CARR`. A table (type P) moves a
point w of the workpiece by what l2 + R1 (l3 + R2 (l4 + w)) is more than at zero, a head
(T) its tool t by l1 + R1 (l2 + R2 (l3 + t)); of one of each (M) the head is l1 + R1 (l2
+ t), the table l3 + R2 (l4 + w). R turns right-handed about v by the angle of the axis,
and the second axis stands on the first. Chains are written closed: at zero nothing is
moved. Swivel cycles use it (CYCLE800), and transformation type 72 for motion of five
axes. Source: SINUMERIK Operate commissioning manual 12/2017, 6FC5397-1DP40-6BA1,
swivelling, pages 566, 572 and 586; 03/2013, page 502; Function Manual Tool Compensation
(W1) 08/2005, pages 2-92, 2-98 (a table whose axis points in +Y, at +45 degrees), 2-100
and 4-3 (l4 of 15 mm in Z, B at 45 degrees: the zero point moves by X 10.607, Z -4.393).
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from truepath.compensation.format import (
    AxisTable,
    CompensationFormat,
    CompensationTables,
    Correction,
    Files,
    RotaryAddition,
    RotaryAxisLocation,
    TemperatureTables,
    list_stated_locations,
)
from truepath.compensation.formats.siemens_lec_cec import (
    CONTROLS,
    DEFAULT_CONTROL,
    MEASURING_SYSTEMS,
    Siemens,
    SiemensCec,
    SiemensLec,
    read_rotary_tables,
)
from truepath.errors import BadInput
from truepath.kinematics.machine.machine import (
    Machine,
    RotaryAxis,
    compute_local_directions,
)
from truepath.kinematics.machine.symbols import LINEAR, TURNS, list_locations

_TEMPERATURE_AREA = "_N_TEMP_COMP_INI"
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
_CLOSED_MM = 5e-6  # rounding of three values
_SAME = 0.9  # cosine: an axis that is tilted more is another one

Vectors = Mapping[str, Float64[np.ndarray, "3"]]


class SiemensOrder(CompensationFormat):
    """Leadscrew and cross tables, thermal growth, and locations of rotary axes."""

    suffix = ".ini"
    choices = SiemensLec.choices
    by_axis = SiemensLec.by_axis
    carries = (
        f"positioning in both directions, of rotary axes the mean of both, modulo a "
        f"turn, and where they are; {SiemensCec.carries}"
    )
    not_carried = (
        "lost motion across or about an axis; what is beyond the tables of the control"
    )
    carries_rotary = True
    units = "mm, of rotary axes deg"
    directions = "each by itself"
    temperature = (
        "growth of each axis as linear temperature compensation, STEM-temperature.ini: "
        "MD32750, SD43910 and SD43920, with SD43910 by temperature for the PLC, which "
        "has to write it. Straightness, squareness and angles change as well: write "
        "the tables anew for other temperatures"
    )
    sign = f"leadscrew: {SiemensLec.sign}; cross: {SiemensCec.sign}"
    sign_is_verified = False

    def __init__(
        self,
        control: str = DEFAULT_CONTROL,
        measuring_system: str = MEASURING_SYSTEMS[0],
    ) -> None:
        self._chosen = control, measuring_system
        self._cross = SiemensCec(control, backlash=True)
        leadscrew = SiemensLec(*self._chosen)
        self.most_points = min(self._cross.most_points, leadscrew.most_points)
        room = CONTROLS[control]
        self.control = f"Siemens {room.title}, leadscrew and cross error compensation"
        self.note = (
            f"STEM-lec: {leadscrew.note}. STEM-cec: {self._cross.note}. Lost motion is "
            "in a cross table of negative travel; MD32450 is to be 0 for that axis. Of "
            "one or two rotary axes STEM-swivel.mpf says where they are, for swivel "
            "cycles and transformation type 72: run it once; the trial is in it"
        )

    def write(self, content: CompensationTables) -> dict[str, str]:
        """`STEM-lec.ini` and `STEM-cec.ini`.

        Of a temperature model `STEM-temperature.ini` as well, of rotary axes
        `STEM-swivel.mpf`.
        """
        lost = {one.axis for one in self._cross.choose(content) if one.direction}
        parts = {"lec": SiemensLec(*self._chosen, lost), "cec": self._cross}
        files: dict[str, str] = {}
        for word, part in parts.items():
            files |= part.write(replace(content, stem=f"{content.stem}-{word}"))
        if content.temperature:
            file = f"{content.stem}-temperature{self.suffix}"
            files[file] = _write_temperature_file(content, content.temperature)
        if vectors := list(write_swivel(content.machine, content.places)):
            comments = (f"; {line}" for line in (*content.stamp, *ABOUT_SWIVEL))
            text = "\n".join([*comments, *vectors, "M30", ""])
            files[f"{content.stem}{SWIVEL}"] = text
        return files

    def read(self, files: Files, machine: Machine) -> Correction:
        """Sum of both kinds of tables. Raises BadInput."""
        parts: tuple[Siemens, ...] = (SiemensLec(), self._cross)
        chosen = [_select_files(files, part) for part in parts]
        for part, own in zip(parts, chosen, strict=True):
            if not own:
                raise BadInput(
                    f"no file of {', '.join(files)} holds _{part.variable} tables: "
                    "give both files of the order, or name the format of the one"
                )
        known = {*chosen[0], *chosen[1], *_select_swivel(files)}
        for file, text in files.items():
            if file not in known and _TEMPERATURE_AREA not in text:
                raise BadInput(f"{file}: holds no tables of a SINUMERIK")
        corrections = [p.read(f, machine) for p, f in zip(parts, chosen, strict=True)]

        def correction(
            position_mm: Float64[np.ndarray, "n a"], direction: float
        ) -> Float64[np.ndarray, "n 3"]:
            added = [one(position_mm, direction) for one in corrections]
            return np.sum(added, axis=0)

        return correction

    def read_rotary(self, files: Files, machine: Machine) -> dict[str, RotaryAddition]:
        """Additions of the leadscrew tables to rotary axes."""
        return read_rotary_tables(_select_files(files, SiemensLec()))

    def list_written_locations(
        self, machine: Machine, places: Sequence[RotaryAxisLocation]
    ) -> frozenset[str]:
        """Locations that the swivel data set contains."""
        return list_swivel_locations(machine, places)

    def read_locations(self, files: Files, machine: Machine) -> dict[str, float]:
        """Locations from the one swivel data set, mm and rad. Raises BadInput."""
        sets = _select_swivel(files)
        if len(sets) > 1:
            raise BadInput(f"one swivel data set is read, not {', '.join(sets)}")
        for name, text in sets.items():
            return read_swivel(name, text, machine)
        return {}


def _select_swivel(files: Files) -> dict[str, str]:
    return {name: text for name, text in files.items() if "$TC_CARR" in text.upper()}


def _select_files(files: Files, kind: Siemens) -> dict[str, str]:
    """Files are recognised by their content, not their name."""
    marks = f"_N_{kind.area}_INI", f"_{kind.variable}["
    return {
        name: text
        for name, text in files.items()
        if any(mark in text for mark in marks)
    }


def _write_temperature_file(
    content: CompensationTables, temperature: TemperatureTables
) -> str:
    lines = [f"%{_TEMPERATURE_AREA}", *(f"; {line}" for line in content.stamp)]
    lines += [
        "; tables hold at the stated temperature, where SD43910 is 0. The PLC writes",
        "; SD43910 = tanbeta(T) by the thermometer; the sign is to be tried",
        "; SD43900 stays 0: drift of the zero of an axis is not told",
        "CHANDATA(1)",
    ]
    for table in temperature.per_kelvin:
        lines += _write_axis(table, temperature)
    return "\n".join([*lines, "M17", ""])


def _compute_slope_per_k(table: AxisTable) -> float:
    # Gradient of an axis' own error through its reference, per kelvin
    off_mm = table.position_mm - table.position_mm[table.reference]
    own = table.mean_mm[:, table.own]
    return float(off_mm @ own / (off_mm @ off_mm))


def _write_axis(table: AxisTable, temperature: TemperatureTables) -> Iterator[str]:
    name = table.axis.name
    if name not in temperature.grows:
        yield f"; {name}: no growth is seen, temperature compensation stays off"
        return
    number = LINEAR.index(name) + 1
    slope = _compute_slope_per_k(table)
    off_mm = table.position_mm - table.position_mm[table.reference]
    left_mm = table.mean_mm[:, table.own] - slope * off_mm
    rms_um = 1e3 * math.sqrt(float(left_mm @ left_mm) / len(left_mm))
    yield f"; {name}: tanbeta(T) = {slope:.4e} (T - {temperature.at_degc:g} degC)"
    yield (
        f"; {1e6 * slope:.2f} um/m per K; a straight line leaves "
        f"{rms_um:.3f} um per K, root mean square"
    )
    yield f"$MA_TEMP_COMP_TYPE[AX{number}]=2"
    reference_mm = table.position_mm[table.reference]
    yield f"$SA_TEMP_COMP_REF_POSITION[AX{number}]={reference_mm:.6f}"
    yield f"$SA_TEMP_COMP_ABS_VALUE[AX{number}]=0"
    yield f"$SA_TEMP_COMP_SLOPE[AX{number}]=0"
    low, high = temperature.low_degc, temperature.high_degc
    count = max(2, round(high - low) + 1)
    for celsius in np.linspace(low, high, count):
        gradient = slope * (celsius - temperature.at_degc)
        yield f";   {celsius:.3f} degC  SD43910 = {gradient:.6e}"


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
        if block.upper() in ("M30", "M17", "M2", "M02"):
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
