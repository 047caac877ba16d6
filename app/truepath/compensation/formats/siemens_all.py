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
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from truepath.compensation.format import (
    AxisTable,
    CompensationFormat,
    CompensationTables,
    Correction,
    TemperatureTables,
)
from truepath.compensation.formats.siemens_controls import CONTROLS, DEFAULT_CONTROL
from truepath.compensation.formats.siemens_leadscrew import MEASURING_SYSTEMS
from truepath.compensation.formats.siemens_lec_cec import (
    Siemens,
    SiemensCec,
    SiemensLec,
)
from truepath.compensation.formats.siemens_parser import read_rotary_tables
from truepath.compensation.formats.siemens_swivel import (
    ABOUT_SWIVEL,
    SWIVEL,
    list_swivel_locations,
    read_swivel,
    write_swivel,
)
from truepath.compensation.rotary_tables import RotaryAddition, RotaryAxisLocation
from truepath.errors import BadInput
from truepath.kinematics.machine.machine import Machine
from truepath.kinematics.machine.symbols import LINEAR

_TEMPERATURE_AREA = "_N_TEMP_COMP_INI"
_STEP_K = 1.0


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

    def read(self, files: Mapping[str, str], machine: Machine) -> Correction:
        """Sum of both kinds of tables. Raises BadInput."""
        parts: tuple[Siemens, ...] = (SiemensLec(), self._cross)
        chosen = [_select(files, part) for part in parts]
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

    def read_rotary(
        self, files: Mapping[str, str], machine: Machine
    ) -> dict[str, RotaryAddition]:
        """Additions of the leadscrew tables to rotary axes."""
        return read_rotary_tables(_select(files, SiemensLec()))

    def list_written_locations(
        self, machine: Machine, places: Sequence[RotaryAxisLocation]
    ) -> frozenset[str]:
        """Locations that the swivel data set contains."""
        return list_swivel_locations(machine, places)

    def read_locations(
        self, files: Mapping[str, str], machine: Machine
    ) -> dict[str, float]:
        """Locations from the one swivel data set, mm and rad. Raises BadInput."""
        sets = _select_swivel(files)
        if len(sets) > 1:
            raise BadInput(f"one swivel data set is read, not {', '.join(sets)}")
        for name, text in sets.items():
            return read_swivel(name, text, machine)
        return {}


def _select_swivel(files: Mapping[str, str]) -> dict[str, str]:
    return {name: text for name, text in files.items() if "$TC_CARR" in text.upper()}


def _select(files: Mapping[str, str], kind: Siemens) -> dict[str, str]:
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
    count = max(2, round((high - low) / _STEP_K) + 1)
    for celsius in np.linspace(low, high, count):
        gradient = slope * (celsius - temperature.at_degc)
        yield f";   {celsius:.3f} degC  SD43910 = {gradient:.6e}"
