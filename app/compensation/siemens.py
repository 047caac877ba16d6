"""Siemens SINUMERIK: leadscrew tables (LEC) and cross tables (CEC).

`$AA_ENC_COMP` holds a table an axis; a positive value moves the axis in the negative
direction, so that the file has the error itself. `$AN_CEC` corrects one axis by the
position of another; its sign is assumed to be the same and has to be tried at the
machine. Both interpolate straight, hold their end values beyond the table, and are
equidistant. Source: SINUMERIK function manual, compensations.
"""

from __future__ import annotations

import re
from abc import abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np
from jaxtyping import Float64

from truepath.app.compensation.format import (
    AxisTable,
    CompensationFormat,
    CompensationTables,
    Correction,
    InterpolatedTable,
    TableFormat,
)
from truepath.app.errors import BadInput
from truepath.app.kinematics.machine import Machine
from truepath.app.kinematics.symbols import LINEAR


class Siemens(TableFormat):
    """One INI file of tables that hold the error.

    area : that the file loads; variable : of the control, a table or a setting of it
    """

    suffix = ".ini"
    area: ClassVar[str]
    variable: ClassVar[str]

    @abstractmethod
    def write_tables(self, tables: Sequence[AxisTable]) -> Iterable[str]:
        """Return the lines of all tables."""

    def write(self, content: CompensationTables) -> dict[str, str]:
        """Return one file for all axes."""
        lines = [f"%_N_{self.area}_INI", *(f"; {s}" for s in content.stamp)]
        lines += ["CHANDATA(1)", *self.write_tables(content.tables), "M17", ""]
        return {f"{content.stem}{self.suffix}": "\n".join(lines)}

    def read_tables(
        self, files: Mapping[str, str], machine: Machine
    ) -> Iterator[InterpolatedTable]:
        """Yield the negative of the tables."""
        for table in _read_settings(files, self.variable):
            yield _make_table(*table)


class SiemensLec(Siemens):
    """Positioning of each axis."""

    control = "Siemens 840D, leadscrew error compensation"
    area, variable = "AX_EEC", "ENC_COMP"
    most_points = 1000
    carries = "positioning of each axis, mean of both directions"
    not_carried = "backlash (MD32450 has it), straightness, angular errors, squareness"
    sign = (
        "the value is the error: a positive value moves the axis in the negative "
        "direction"
    )
    sign_is_verified = True
    note = (
        "rename X1, Y1, Z1 to the machine axes; MD38000 must hold the points; load "
        "with MD32700 = 0, set it to 1, reference the axes"
    )

    def write_tables(self, tables: Sequence[AxisTable]) -> Iterator[str]:
        """Yield a table an axis."""
        for table in tables:
            axis = f"{table.axis.name}1"
            for index, value in enumerate(table.mean_mm[:, table.own]):
                yield f"$AA_ENC_COMP[0,{index},{axis}]={value:z.6f}"
            yield f"$AA_ENC_COMP_STEP[0,{axis}]={table.spacing_mm:.9g}"
            yield f"$AA_ENC_COMP_MIN[0,{axis}]={table.position_mm[0]:.6f}"
            yield f"$AA_ENC_COMP_MAX[0,{axis}]={table.position_mm[-1]:.6f}"
            yield f"$AA_ENC_COMP_IS_MODULO[0,{axis}]=0"


class SiemensCec(Siemens):
    """What each axis does across itself: cross tables."""

    control = "Siemens 840D, cross error compensation"
    area, variable = "NC_CEC", "CEC"
    most_points = 500
    carries = "straightness and squareness, along the middle of the travel"
    not_carried = (
        "positioning (siemens-lec has it), angular errors away from the middle"
    )
    sign = "the value is the error of the output axis, as in leadscrew tables"
    sign_is_verified = False
    note = (
        "AX1, AX2, AX3 are X, Y, Z; MD18342 sizes the tables, MD32710 enables them; a "
        "licensed option; verify by a probe move that the tables act at all"
    )

    def write_tables(self, tables: Sequence[AxisTable]) -> Iterator[str]:
        """Yield two tables an axis."""
        pairs = [(t, out) for t in tables for out in range(3) if out != t.own]
        for number, (table, out) in enumerate(pairs):
            for index, value in enumerate(table.mean_mm[:, out]):
                yield f"$AN_CEC[{number},{index}]={value:z.6f}"
            yield f"$AN_CEC_INPUT_AXIS[{number}]=(AX{table.own + 1})"
            yield f"$AN_CEC_OUTPUT_AXIS[{number}]=(AX{out + 1})"
            yield f"$AN_CEC_STEP[{number}]={table.spacing_mm:.9g}"
            yield f"$AN_CEC_MIN[{number}]={table.position_mm[0]:.6f}"
            yield f"$AN_CEC_MAX[{number}]={table.position_mm[-1]:.6f}"
            yield f"$AN_CEC_DIRECTION[{number}]=0"
            yield f"$AN_CEC_MULT_BY_TABLE[{number}]=0"
            yield f"$AN_CEC_IS_MODULO[{number}]=0"


class SiemensOrder(CompensationFormat):
    """Both kinds of tables, as one order: what each lacks the other has."""

    control = "Siemens 840D sl, leadscrew and cross error compensation"
    suffix = ".ini"
    most_points = SiemensCec.most_points
    carries = "positioning (mean of both directions), straightness and squareness"
    not_carried = "backlash (MD32450 has it), angular errors away from the middle"
    sign = f"leadscrew: {SiemensLec.sign}; cross: {SiemensCec.sign}"
    sign_is_verified = False
    note = f"STEM-lec: {SiemensLec.note}. STEM-cec: {SiemensCec.note}"
    parts: ClassVar[Mapping[str, Siemens]] = {"lec": SiemensLec(), "cec": SiemensCec()}

    def write(self, content: CompensationTables) -> dict[str, str]:
        """Return `STEM-lec.ini` and `STEM-cec.ini`."""
        files: dict[str, str] = {}
        for word, part in self.parts.items():
            files |= part.write(replace(content, stem=f"{content.stem}-{word}"))
        return files

    def read(self, files: Mapping[str, str], machine: Machine) -> Correction:
        """Return the sum of both."""
        corrections = [
            part.read(_select(files, f"-{word}{self.suffix}"), machine)
            for word, part in self.parts.items()
        ]

        def correction(
            position_mm: Float64[np.ndarray, "n a"], direction: float
        ) -> Float64[np.ndarray, "n 3"]:
            added = [one(position_mm, direction) for one in corrections]
            return np.sum(added, axis=0)

        return correction


def _select(files: Mapping[str, str], end: str) -> dict[str, str]:
    return {name: text for name, text in files.items() if name.endswith(end)}


_SETTING = re.compile(
    r"\$A[AN]_(ENC_COMP|CEC)(\w*)\[([\w,]+)\]="
    r"\(?(AX\d|[-+]?\d+\.?\d*(?:e[-+]\d+)?)\)?$"
)


def _read_settings(
    files: Mapping[str, str], kind: str
) -> list[tuple[str, dict[str, str], dict[int, float]]]:
    """Return (table, settings, values by index) of every table of the files."""
    names: dict[str, dict[str, str]] = {}
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
            if word:
                names.setdefault(table, {})[word] = value
            else:
                values.setdefault(table, {})[int(places[1])] = float(value)
    return [(table, names[table], values[table]) for table in values]


def _make_table(
    name: str, settings: dict[str, str], values: dict[int, float]
) -> InterpolatedTable:
    """Return a table with the sign of what is added: minus the error.

    name : a leadscrew table has that of its axis, a cross table a number
    """
    if "_INPUT_AXIS" in settings:
        words = settings["_INPUT_AXIS"], settings["_OUTPUT_AXIS"]
        own, out = (int(word.removeprefix("AX")) - 1 for word in words)
    else:
        own = out = LINEAR.index(name.rstrip("0123456789"))
    step, low = float(settings["_STEP"]), float(settings["_MIN"])
    count = round((float(settings["_MAX"]) - low) / step) + 1
    if sorted(values) != list(range(count)):
        raise BadInput(f"the table of {LINEAR[own]} lacks points between MIN and MAX")
    added = -np.array([values[index] for index in range(count)])
    at = low + step * np.arange(count)
    return InterpolatedTable(LINEAR[own], out, at, added)
