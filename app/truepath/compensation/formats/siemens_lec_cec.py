"""Siemens SINUMERIK: leadscrew tables (LEC) and cross tables (CEC).

`$AA_ENC_COMP` holds a table per axis; a positive value moves the axis in the negative
direction, so that the file has the error itself. `$AN_CEC` corrects one axis by the
position of another, or by a product of two tables; its sign is assumed to be the same
and has to be tried at the machine. Both interpolate linearly, hold their end values
beyond the table, and are equidistant. Source: SINUMERIK Function Manual Extended
Functions 03/2013, K3, pages 238 to 264.

`$AA_ENC_COMP[e, N, axis]`, as MD32700 and MD38000 of it, has e = 0 for measuring system
1 and e = 1 for measuring system 2; a table acts while its system is the active one of
the axis. The reading of both kinds of tables is independent of their writers.
"""

from __future__ import annotations

import re
from abc import abstractmethod
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float64

from truepath.compensation.format import (
    CompensationTables,
    Files,
    InterpolatedTable,
    RotaryAddition,
    TableFormat,
    split_by_axis,
)
from truepath.compensation.formats.siemens_cross import (
    FACTOR_MM,
    CrossTable,
    choose_cross_tables,
    find_factor,
    list_factors,
)
from truepath.errors import BadInput
from truepath.kinematics.machine.machine import Machine
from truepath.kinematics.machine.symbols import LINEAR, TURNS

MEASURING_SYSTEMS = ("1", "2")
_SETTING = re.compile(
    r"\$A[AN]_(ENC_COMP|CEC)(\w*)\[([\w,]+)\]="
    r"\(?(AX\d|[-+]?\d+\.?\d*(?:e[-+]\d+)?)\)?$"
)


@dataclass(frozen=True, slots=True)
class Control:
    """Numbers of points and tables of a control.

    note : source of the numbers
    measuring_systems : that an axis may have
    """

    title: str
    leadscrew_points: int
    cross_points: int
    cross_tables: int
    note: str
    measuring_systems: frozenset[str] = frozenset(MEASURING_SYSTEMS)


CONTROLS = {
    "840d-sl": Control("840D sl", 1000, 500, 62, "MD38000 and MD18342 size the tables"),
    "828d": Control(
        "828D", 200, 200, 8, "8 cross tables of 200 points, fixed; MD38000 the others"
    ),
    "808d": Control(
        "808D",
        200,
        200,
        8,
        "no public text at hand states its limits: those of the 828D are taken; "
        "compare MD38000 and MD18342 before loading",
        frozenset({"1"}),  # function manual 01/2017, page 106
    ),
}
DEFAULT_CONTROL = "840d-sl"


class Siemens(TableFormat):
    """One INI file of tables that hold the error.

    area : that the file loads; variable : of the control, a table or a setting of it
    control : key of its limits
    remarks : comments of the file in addition to its stamp
    """

    suffix = ".ini"
    choices: ClassVar[Mapping[str, tuple[str, ...]]] = {"control": tuple(CONTROLS)}
    area: ClassVar[str]
    variable: ClassVar[str]
    remarks: tuple[str, ...] = ()

    def __init__(self, control: str = DEFAULT_CONTROL) -> None:
        self.room = CONTROLS[control]

    @abstractmethod
    def write_tables(self, content: CompensationTables) -> Iterable[str]:
        """Lines of all tables."""

    def write(self, content: CompensationTables) -> dict[str, str]:
        """One file for all axes."""
        comments = (*content.stamp, *self.remarks)
        lines = [f"%_N_{self.area}_INI", *(f"; {s}" for s in comments)]
        lines += ["CHANDATA(1)", *self.write_tables(content), "M17", ""]
        return {f"{content.stem}{self.suffix}": "\n".join(lines)}

    def read_tables(
        self, files: Files, machine: Machine
    ) -> Iterator[InterpolatedTable]:
        """Negative of the tables."""
        return _read_tables(files, self.variable)


class SiemensLec(Siemens):
    """Positioning of each axis, in tables of one of its measuring systems.

    measuring_system : of `MEASURING_SYSTEMS` for all axes, or by axis as `X=1,Y=2`;
        system 1 for those that it does not name
    forward : axes whose tables are those of positive travel; else the mean
    """

    area, variable = "AX_EEC", "ENC_COMP"
    carries = (
        "positioning of each axis, mean of both directions, of rotary axes modulo "
        "a turn"
    )
    not_carried = (
        "backlash (MD32450 has it), straightness, angular errors, squareness, "
        "lost motion across or about an axis"
    )
    carries_rotary = True
    units = "mm, of rotary axes deg"
    sign = (
        "the value is the error: a positive value moves the axis in the negative "
        "direction"
    )
    sign_is_verified = True

    choices: ClassVar[Mapping[str, tuple[str, ...]]] = {
        **Siemens.choices,
        "measuring_system": MEASURING_SYSTEMS,
    }
    by_axis = ("measuring_system",)

    def __init__(
        self,
        control: str = DEFAULT_CONTROL,
        measuring_system: str = MEASURING_SYSTEMS[0],
        forward: Collection[str] = (),
    ) -> None:
        super().__init__(control)
        self._by_axis = split_by_axis(measuring_system, MEASURING_SYSTEMS)
        self._others = MEASURING_SYSTEMS[0] if self._by_axis else measuring_system
        known = self.room.measuring_systems
        for number in (self._others, *self._by_axis.values()):
            if number not in known:
                raise BadInput(
                    f"measuring_system: the {self.room.title} has {', '.join(known)} "
                    f"alone, not {number}; choose another control or measuring system"
                )
        self._forward = forward
        title, active = f"system {measuring_system}", "each axis"
        index = str(self._find_index(""))
        if self._by_axis:
            stated = ", ".join(f"{n} of {axis}" for axis, n in self._by_axis.items())
            title, index = f"system {stated}, {self._others} of others", "e"
            active = "its axis, e being one less than its number"
        self.remarks = (
            f"tables of measuring {title}: $AA_ENC_COMP[{index}, ...]; it has to be "
            f"the active one of {active}",
        )
        self.most_points = self.room.leadscrew_points
        self.control = f"Siemens {self.room.title}, leadscrew error compensation"
        self.note = (
            f"rename X1, Y1, Z1 to the machine axes; the tables are of measuring "
            f"{title} ($AA_ENC_COMP[{index}, ...]), which has to be the active one of "
            f"{active}; MD38000[{index}] must hold the points; load with "
            f"MD32700[{index}] = 0, set it to 1, reference the axes ({self.room.note})"
        )

    def _find_index(self, axis: str) -> int:
        return MEASURING_SYSTEMS.index(self._by_axis.get(axis, self._others))

    def write_tables(self, content: CompensationTables) -> Iterator[str]:
        """A table per axis. Raises BadInput for a measuring system of no axis."""
        names = content.machine.axis_names
        for axis in self._by_axis:
            if axis not in names:
                raise BadInput(
                    f"measuring_system: the machine has no axis {axis}; it has "
                    f"{', '.join(names)}"
                )
        for one in content.tables:
            forward = one.axis.name in self._forward
            values = (one.forward_mm if forward else one.mean_mm)[:, one.own]
            step = one.spacing_mm
            yield from self._write(one.axis.name, values, one.position_mm, step)
        for one in content.rotary:
            # With IS_MODULO the value at MAX is followed by that at MIN, so both are
            # the same: K3, pages 238 to 242.
            columns = one.error_deg, one.position_deg, one.spacing_deg
            yield from self._write(one.axis.name, *columns, modulo=one.axis.turns_fully)

    def _write(
        self,
        axis: str,
        values: Float64[np.ndarray, " n"],
        position: Float64[np.ndarray, " n"],
        step: float,
        *,
        modulo: bool = False,
    ) -> Iterator[str]:
        index = self._find_index(axis)
        place = f"[{index},{axis}1]"
        for row, value in enumerate(values.tolist()):
            yield f"$AA_ENC_COMP[{index},{row},{axis}1]={value:z.6f}"
        yield f"$AA_ENC_COMP_STEP{place}={step:.9g}"
        yield f"$AA_ENC_COMP_MIN{place}={position[0]:.6f}"
        yield f"$AA_ENC_COMP_MAX{place}={position[-1]:.6f}"
        yield f"$AA_ENC_COMP_IS_MODULO{place}={int(modulo)}"

    def read_rotary(self, files: Files, machine: Machine) -> dict[str, RotaryAddition]:
        """Negative of the tables of rotary axes."""
        return read_rotary_tables(files)


class SiemensCec(Siemens):
    """Cross tables: errors of an axis across itself, and together with another one.

    backlash : whether lost motion is included; the leadscrew tables are then those of
        positive travel
    """

    area, variable = "NC_CEC", "CEC"
    carries = (
        "straightness and squareness along the middle of the travel; as products of "
        "two tables what the angular errors of an axis do at the positions of another, "
        "and sag"
    )
    not_carried = (
        "positioning (siemens-lec has it); lost motion across or about an axis; what "
        "is beyond the tables of the control"
    )
    sign = "the value is the error of the output axis, as in leadscrew tables"
    sign_is_verified = False

    def __init__(
        self, control: str = DEFAULT_CONTROL, *, backlash: bool = False
    ) -> None:
        super().__init__(control)
        self._backlash = backlash
        self.most_points = self.room.cross_points
        self.control = f"Siemens {self.room.title}, cross error compensation"
        self.note = (
            "AX1, AX2, AX3 are X, Y, Z; MD32710 enables the tables, SD41300 each of "
            "them; a licensed option; verify by a probe move that they act at all. A "
            "table with MULT_BY_TABLE is taken to act by the product alone, as in the "
            "manual's foundation that sags, and the table that it names by nothing "
            f"else: values of that are {FACTOR_MM} mm at most, should the control add "
            f"it by itself ({self.room.note})"
        )

    def choose(self, content: CompensationTables) -> list[CrossTable]:
        """The tables with the largest corrections, as many as the control has."""
        return choose_cross_tables(
            content.machine,
            content.tables,
            self.room.cross_tables,
            backlash=self._backlash,
        )

    def write_tables(self, content: CompensationTables) -> Iterator[str]:
        """The chosen tables, then the second ones of their products."""
        chosen = self.choose(content)
        factors = list_factors(chosen)
        for number, one in enumerate(chosen):
            times = 0
            if one.factor:  # named by its number, which is its index + 1
                times = len(chosen) + find_factor(one, factors) + 1
            yield from _write_cross(number, one, times)
        for k, (out, factor) in enumerate(factors):
            one = CrossTable(factor.axis, out, factor.position_mm, factor.value_mm, 0.0)
            yield from _write_cross(len(chosen) + k, one, 0)


def _write_cross(number: int, one: CrossTable, times: int) -> Iterator[str]:
    for index, value in enumerate(one.value_mm):
        yield f"$AN_CEC[{number},{index}]={value:z.6f}"
    at = one.position_mm
    yield f"$AN_CEC_INPUT_AXIS[{number}]=(AX{LINEAR.index(one.axis) + 1})"
    yield f"$AN_CEC_OUTPUT_AXIS[{number}]=(AX{one.out + 1})"
    yield f"$AN_CEC_STEP[{number}]={at[1] - at[0]:.9g}"
    yield f"$AN_CEC_MIN[{number}]={at[0]:.6f}"
    yield f"$AN_CEC_MAX[{number}]={at[-1]:.6f}"
    yield f"$AN_CEC_DIRECTION[{number}]={one.direction}"
    yield f"$AN_CEC_MULT_BY_TABLE[{number}]={times}"
    yield f"$AN_CEC_IS_MODULO[{number}]=0"


def _read_tables(files: Files, kind: str) -> Iterator[InterpolatedTable]:
    """Corrections by the tables of a kind: minus their values.

    kind : `ENC_COMP` or `CEC`. A table that multiplies another adds nothing alone.

    Raises BadInput naming file and row, or the table that lacks something.
    """
    settings = [one for one in _read_settings(files, kind) if one[0][0] not in TURNS]
    tables = {name: _make_table(name, words, v) for name, words, v in settings}
    times = {
        name: str(int(words["_MULT_BY_TABLE"]) - 1)
        for name, words, _ in settings
        if int(words.get("_MULT_BY_TABLE", "0"))
    }
    for name, words, _ in settings:
        if name in times.values():
            continue
        side = int(words.get("_DIRECTION", "0"))
        yield tables[name].multiply(tables.get(times.get(name, "")), side)


def read_rotary_tables(files: Files) -> dict[str, RotaryAddition]:
    """Corrections of rotary axes by leadscrew tables: minus their values, deg.

    Raises BadInput as `_read_tables`.
    """
    added: dict[str, RotaryAddition] = {}
    for name, words, values in _read_settings(files, "ENC_COMP"):
        if name[0] in TURNS:
            at, value = _list_rows(name[0], words, values)
            is_modulo = int(words.get("_IS_MODULO", "0"))
            period = float(at[-1] - at[0]) if is_modulo else 0.0
            added[name[0]] = RotaryAddition(at, -value, period)
    return added


def _read_settings(
    files: Files, kind: str
) -> list[tuple[str, dict[str, str], dict[int, float]]]:
    names: dict[str, dict[str, str]] = {}
    systems: dict[str, str] = {}
    values: dict[str, dict[int, float]] = {}
    for name, text in files.items():
        for number, line in enumerate(text.splitlines(), 1):
            block = line.partition(";")[0].strip()
            if not block.startswith("$"):
                continue
            setting = _SETTING.fullmatch(block)
            if setting is None or setting.group(1) != kind:
                raise BadInput(f"{name}, row {number}: {block!r} cannot be read")
            _, word, place, value = setting.groups()
            places = place.split(",")
            # A leadscrew table is named by its axis, a cross table by its number.
            table = places[-1] if kind == "ENC_COMP" else places[0]
            if places[0] != systems.setdefault(table, places[0]):
                raise BadInput(
                    f"{name}, row {number}: {table} has a table of measuring system "
                    f"{int(systems[table]) + 1} as well; keep that of the active one"
                )
            if word:
                names.setdefault(table, {})[word] = value
            else:
                values.setdefault(table, {})[int(places[1])] = float(value)
    return [(table, names[table], values[table]) for table in values]


def _make_table(
    name: str, settings: dict[str, str], values: dict[int, float]
) -> InterpolatedTable:
    """With the sign of the correction: minus the error.

    name : a leadscrew table has that of its axis, a cross table a number
    """
    if "_INPUT_AXIS" in settings:
        words = settings["_INPUT_AXIS"], settings["_OUTPUT_AXIS"]
        own, out = (int(word.removeprefix("AX")) - 1 for word in words)
    else:
        own = out = LINEAR.index(name.rstrip("0123456789"))
    at, value = _list_rows(LINEAR[own], settings, values)
    return InterpolatedTable(LINEAR[own], out, at, -value)


def _list_rows(
    axis: str, settings: Mapping[str, str], values: Mapping[int, float]
) -> tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
    step, low = float(settings["_STEP"]), float(settings["_MIN"])
    count = round((float(settings["_MAX"]) - low) / step) + 1
    if sorted(values) != list(range(count)):
        raise BadInput(f"the table of {axis} lacks points between MIN and MAX")
    value = np.array([values[index] for index in range(count)])
    return low + step * np.arange(count), value
