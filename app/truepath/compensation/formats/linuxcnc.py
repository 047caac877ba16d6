"""LinuxCNC: a `COMP_FILE` per joint, type 0.

Rows `nominal forward reverse`, ascending, joint units, at most 256; columns 2 and 3 are
the positions reached, and the controller sends the motor to command + nominal − column.
No header and no comment: the loader stops silently at the first line that is not three
numbers. Source: LinuxCNC `src/emc/motion/usrmotintf.cc`, `control.c`.

Of a trunnion, `xyzac-trt-kins` or `xyzbc-trt-kins`, pins give the locations of the
axes: the C axis at (x, y)-rot-point; the tilting axis off it by y-offset (A) or
x-offset (B), and z-offset above z-rot-point. The table turns right-handed where
`conventional-directions` is off, as by default. Source: LinuxCNC
`src/emc/kinematics/trtfuncs.c`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float64

from truepath.compensation.format import (
    AxisTable,
    CompensationTables,
    Files,
    InterpolatedTable,
    RotaryAddition,
    RotaryAxisLocation,
    RotaryTable,
    TableFormat,
    list_stated_locations,
)
from truepath.errors import BadInput
from truepath.kinematics.machine.machine import Machine
from truepath.kinematics.machine.symbols import LINEAR, TURNS

_WIDEST_DEG = 5.0  # between rows, for the sake of further turns
_KINEMATICS = "-kinematics.hal"
_ABOUT_PINS = (
    "mm, in machine coordinates; conventional-directions off, tool-offset connected to",
    "motion.tooloffset.z, whose length counts along -Z from the point the joints move",
    "sign: the axes stand where these points are; tilts of the axes have no pins",
    "they are as right as the offset of the first target is known, which is in each of",
    "them: enter it measured, from the point the joints move, in all three directions",
    "trial: probe the centre of a ball on the table at C 0 and C 180 and at two tilts:",
    "with these pins its four centres differ less than with those of the drawing",
)
_PIN = re.compile(r"setp (xyz[ab]c-trt-kins)\.([xyz]-(?:rot-point|offset)) (\S+)")
# The direction across both axes, in which they are offset from each other.
_ACROSS = {"A": 1, "B": 0}
_DIRECTIONS = {"A": (1.0, 0.0, 0.0), "B": (0.0, 1.0, 0.0), "C": (0.0, 0.0, 1.0)}


class LinuxCnc(TableFormat):
    """One table per linear axis, both directions, and one per rotary axis."""

    control = "LinuxCNC"
    suffix = ".tbl"
    most_points = 256
    carries = "positioning of each axis, forward and reverse, of rotary axes too"
    not_carried = "straightness, angular errors, squareness"
    carries_rotary = True
    units = "mm, of rotary axes deg"
    directions = "each by itself"
    sign = "columns 2 and 3 are positions reached: nominal + error (COMP_FILE_TYPE = 0)"
    sign_is_verified = True
    note = (
        "name each file as COMP_FILE of its [JOINT_n], with COMP_FILE_TYPE = 0; the "
        "tables are read when LinuxCNC starts, and replace BACKLASH. A rotary joint "
        "counts turns, a wrapped one too: beyond the rows of its table, which the "
        "account states, it keeps the end value, uncorrected. Of a C table on a "
        "trunnion STEM-kinematics.hal sets where the axes are: a HALFILE after the one "
        "that loads xyzac-trt-kins or xyzbc-trt-kins; the trial is in it"
    )

    def write(self, content: CompensationTables) -> dict[str, str]:
        """A table per axis, `STEM-X.tbl`; deg for a rotary axis."""
        tables = {one.axis.name: _write_rows(one) for one in content.tables}
        tables |= {one.axis.name: _write_rotary_rows(one) for one in content.rotary}
        files = {f"{content.stem}-{a}{self.suffix}": rows for a, rows in tables.items()}
        if pins := list(_write_kinematics(content.machine, content.places)):
            comments = (f"# {line}" for line in (*content.stamp, *_ABOUT_PINS))
            text = "\n".join([*comments, *pins, ""])
            files[f"{content.stem}{_KINEMATICS}"] = text
        return files

    def read_tables(
        self, files: Files, machine: Machine
    ) -> Iterator[InterpolatedTable]:
        """Trims that the controller adds."""
        for name, text in files.items():
            axis = _find_axis(name, self.suffix)
            if not axis and not name.endswith(_KINEMATICS):
                raise BadInput(
                    f"{name}: the name of a table ends in its axis and {self.suffix}"
                )
            if axis in LINEAR:
                nominal, forward, reverse = _read_rows(name, text)
                out, up, down = LINEAR.index(axis), nominal - forward, nominal - reverse
                yield InterpolatedTable(axis, out, nominal, up, down)

    def read_rotary(self, files: Files, machine: Machine) -> dict[str, RotaryAddition]:
        """Trims of rotary joints; end values hold beyond."""
        added: dict[str, RotaryAddition] = {}
        for name, text in files.items():
            axis = _find_axis(name, self.suffix)
            if axis in TURNS:
                nominal, forward, reverse = _read_rows(name, text)
                trim = nominal - 0.5 * (forward + reverse)
                half = 0.5 * (reverse - forward)
                added[axis] = RotaryAddition(nominal, trim, half_deg=half)
        return added

    def list_written_locations(
        self, machine: Machine, places: Sequence[RotaryAxisLocation]
    ) -> frozenset[str]:
        """Locations that the pins contain."""
        return _list_pin_places(machine, places)

    def read_locations(self, files: Files, machine: Machine) -> dict[str, float]:
        """Locations from the pins of the kinematics, mm and rad."""
        for name, text in files.items():
            if name.endswith(_KINEMATICS):
                return _read_kinematics(name, text, machine)
        return {}


def _write_rows(table: AxisTable) -> str:
    at, own = table.position_mm, table.own
    forward, backward = at + table.forward_mm[:, own], at + table.backward_mm[:, own]
    return "".join(
        f"{a:.6f} {f:.6f} {b:.6f}\n"
        for a, f, b in zip(at, forward, backward, strict=True)
    )


def _write_rotary_rows(table: RotaryTable) -> str:
    """Rows over the whole travel, since joints count turns and have no period.

    A wrapped axis continues into the next turn; where there is room, the turns next to
    the travel have rows too.

    The mean of both directions is 0 at the axis zero, for which the locations of the
    axes are given.
    """
    axis, most = table.axis, LinuxCnc.most_points
    low, high, period = axis.low, axis.high, None
    if axis.turns_fully:
        room_deg = _WIDEST_DEG * (most - 1) - (high - low)
        period, beyond = 360.0, 360.0 * max(0, room_deg // 720.0)
        low, high = low - beyond, high + beyond
    count = math.ceil((high - low) / table.spacing_deg - 1e-9) + 1
    at = np.linspace(low, high, min(count, most))
    error, half = (
        np.interp(at, table.position_deg, value, period=period)
        for value in (table.error_deg, table.half_deg)
    )
    rows = zip(at, at + error + half, at + error - half, strict=True)
    return "".join(f"{a:.6f} {f:.6f} {r:.6f}\n" for a, f, r in rows)


def _find_axis(name: str, suffix: str) -> str:
    """The axis' letter ends the name of the file; else empty."""
    return name.removesuffix(suffix)[-1] if name.endswith(suffix) else ""


def _read_rows(name: str, text: str) -> Float64[np.ndarray, "3 n"]:
    rows: list[list[float]] = []
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split()
        if len(words) != 3:
            raise BadInput(f"{name}, row {number}: a row has three numbers")
        rows.append([float(word) for word in words])
    table = np.array(rows).T
    if len(rows) > 256 or (np.diff(table[0]) <= 0).any():
        raise BadInput(f"{name}: 256 rows at most, ascending")
    return table


def _find_tilting_axis(machine: Machine) -> str | None:
    # A or B of a C table on a trunnion, w-C-A-…-b
    names = machine.workpiece_side[:2]
    if len(machine.rotary_axes) != 2 or names[:1] != ("C",) or len(names) < 2:
        return None
    straight = all(
        one.direction == _DIRECTIONS[one.name] for one in machine.rotary_axes
    )
    return names[1] if names[1] in _ACROSS and straight else None


def _list_pin_places(
    machine: Machine, places: Sequence[RotaryAxisLocation]
) -> frozenset[str]:
    # None where one of its axes is unknown: its pins would be those of the drawing
    tilting = _find_tilting_axis(machine)
    if tilting is None or not all(place.known for place in places):
        return frozenset()
    across = LINEAR[_ACROSS[tilting]]
    pins = {"XOC", "YOC", f"{across}O{tilting}", f"ZO{tilting}"}
    return list_stated_locations(places) & pins


def _write_kinematics(
    machine: Machine, places: tuple[RotaryAxisLocation, ...]
) -> Iterator[str]:
    tilting = _find_tilting_axis(machine)
    if tilting is None or not _list_pin_places(machine, places):
        return
    at = {place.axis.name: place.origin_mm for place in places}
    module, across = f"xyz{tilting.lower()}c-trt-kins", _ACROSS[tilting]
    turn, tilt = at["C"], at[tilting]
    for k, letter in enumerate("xyz"):
        yield f"setp {module}.{letter}-rot-point {turn[k]:.6f}"
    for k in (across, 2):
        yield f"setp {module}.{'xyz'[k]}-offset {tilt[k] - turn[k]:.6f}"


def _read_kinematics(name: str, text: str, machine: Machine) -> dict[str, float]:
    # Location errors, mm
    tilting = _find_tilting_axis(machine)
    lines = [line for line in text.splitlines() if line and line[0] != "#"]
    pins: dict[str, float] = {}
    for line in lines:
        pin = _PIN.fullmatch(line)
        if pin is None or pin[1] != f"xyz{(tilting or '?').lower()}c-trt-kins":
            raise BadInput(f"{name}: {line!r} is no pin of this machine's kinematics")
        pins[pin[2]] = float(pin[3])
    if tilting is None or len(pins) != 5:
        raise BadInput(f"{name}: five pins are wanted, x-rot-point to z-offset")
    across = _ACROSS[tilting]
    point = np.array([pins[f"{letter}-rot-point"] for letter in "xyz"])
    letter = "xyz"[across]
    turn, tilt = (np.array(machine.rotary(one).origin_mm) for one in ("C", tilting))
    return {
        "XOC": float(point[0] - turn[0]),
        "YOC": float(point[1] - turn[1]),
        f"{letter.upper()}O{tilting}": float(
            point[across] + pins[f"{letter}-offset"] - tilt[across]
        ),
        f"ZO{tilting}": float(point[2] + pins["z-offset"] - tilt[2]),
    }
