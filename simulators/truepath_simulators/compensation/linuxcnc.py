"""LinuxCNC: a `COMP_FILE` of type 0 per joint, and kinematics by pins.

Rows of the file are `nominal forward reverse`; the loader keeps nominal − column as
trim and adds it. Source: `src/emc/motion/usrmotintf.cc`, `control.c`.

The table of `xyzac-trt-kins` or `xyzbc-trt-kins` comes from its pins.

A program names points of the workpiece. With the pins of the machine as built the
joints would reach the commanded positions; with those of a file they reach others.
`conventional-directions` is off. Source: `src/emc/kinematics/trtfuncs.c`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from truepath_simulators.compensation.correction import Correction, Curve, Term
from truepath_simulators.errors import SimulatorError
from truepath_simulators.machine_file import MachineFile

_SETP = re.compile(r"setp\s+xyz([ab])c-trt-kins\.([xyz])-(rot-point|offset)\s+(\S+)")


@dataclass(frozen=True, slots=True)
class KinematicCorrection(Correction):
    """Motion of the linear joints due to pins that differ from the nominal ones.

    tilt : column of the tilting joint; across : of the direction of its offset
    nominal, given : rot-point and offset, (2, 3) mm, the tool's length in the offset
    """

    tilt: int
    turn: int
    across: int
    nominal: np.ndarray
    given: np.ndarray

    def added(self, position: np.ndarray, heading: np.ndarray) -> np.ndarray:
        del heading
        total = np.zeros_like(position, dtype=float)
        tilt, turn = (np.radians(position[:, k]) for k in (self.tilt, self.turn))
        world = self._forward(position[:, :3], tilt, turn)
        total[:, :3] = self._inverse(world, tilt, turn) - position[:, :3]
        return total

    def _forward(
        self, joint: np.ndarray, tilt: np.ndarray, turn: np.ndarray
    ) -> np.ndarray:
        point, offset = self.nominal
        carried = self._tilt(joint - point - offset, -tilt) + offset
        return _turn_about_z(carried, -turn) + point

    def _inverse(
        self, world: np.ndarray, tilt: np.ndarray, turn: np.ndarray
    ) -> np.ndarray:
        point, offset = self.given
        carried = _turn_about_z(world - point, turn) - offset
        return self._tilt(carried, tilt) + offset + point

    def _tilt(self, vector: np.ndarray, angle: np.ndarray) -> np.ndarray:
        """Right-handed about X, or about Y where the offset is along X."""
        first, second = (1, 2) if self.across == 1 else (2, 0)
        turned = vector.copy()
        cosine, sine = np.cos(angle), np.sin(angle)
        turned[:, first] = cosine * vector[:, first] - sine * vector[:, second]
        turned[:, second] = sine * vector[:, first] + cosine * vector[:, second]
        return turned


def is_kinematics(text: str) -> bool:
    return _SETP.search(text) is not None


def read_kinematics(name: str, text: str, machine: MachineFile) -> KinematicCorrection:
    """Kinematics by the pins. Raises SimulatorError."""
    pins: dict[str, float] = {}
    letters: set[str] = set()
    for number, line in enumerate(text.splitlines(), 1):
        words = line.partition("#")[0].strip()
        if not words:
            continue
        pin = _SETP.fullmatch(words)
        if pin is None:
            raise SimulatorError(f"{name}, row {number}: {words!r} is not understood")
        letters.add(pin[1].upper())
        pins[f"{pin[2]}-{pin[3]}"] = float(pin[4])
    tilting = letters.pop()
    axes = {axis.name: axis for axis in machine.rotary_axes}
    if letters or set(axes) != {tilting, "C"}:
        raise SimulatorError(f"{name}: the machine has no axes {tilting} and C")
    across = 1 if tilting == "A" else 0
    length = -machine.reflector().offset_mm[2]  # of the tool, tool-offset
    turn, tilt = (np.array(axes[one].origin_mm, float) for one in ("C", tilting))
    return KinematicCorrection(
        machine.axis_names.index(tilting),
        machine.axis_names.index("C"),
        across,
        _split(turn, tilt - turn, across, length),
        _split(*_take(pins), across, length),
    )


def _take(pins: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
    point, offset = (
        np.array([pins.get(f"{letter}-{what}", 0.0) for letter in "xyz"])
        for what in ("rot-point", "offset")
    )
    return point, offset


def _split(
    point: np.ndarray, offset: np.ndarray, across: int, length: float
) -> np.ndarray:
    used = np.zeros(3)
    used[across] = offset[across]
    used[2] = offset[2] + length
    return np.stack([point, used])


def _turn_about_z(vector: np.ndarray, angle: np.ndarray) -> np.ndarray:
    cosine, sine = np.cos(angle), np.sin(angle)
    x, y, z = vector.T
    return np.stack([cosine * x - sine * y, sine * x + cosine * y, z], axis=1)


_MOST_ROWS = 256
_AXIS = re.compile(r"(?:^|[-_.])([XYZABC])\.\w+$", re.IGNORECASE)


def read_linuxcnc(name: str, text: str, machine: MachineFile) -> Iterator[Term]:
    """Trims of the joint whose letter ends the name, as in `comp-X.tbl`."""
    letter = _AXIS.search(name)
    axis = letter.group(1).upper() if letter else ""
    if axis not in machine.axis_names:
        raise SimulatorError(
            f"{name}: the name does not end in an axis of the machine, as comp-X.tbl"
        )
    column = machine.axis_names.index(axis)
    nominal, forward, reverse = _read_rows(name, text).T
    for side, reached in ((1, forward), (-1, reverse)):
        yield Term(column, (Curve(column, nominal, nominal - reached, side),))


def _read_rows(name: str, text: str) -> np.ndarray:
    rows: list[list[float]] = []
    for number, line in enumerate(text.splitlines(), 1):
        try:
            first, second, third = map(float, line.split())
        except ValueError as error:
            raise SimulatorError(
                f"{name}, row {number}: not three numbers; LinuxCNC would stop there "
                "without a word"
            ) from error
        rows.append([first, second, third])
    table = np.array(rows).reshape(-1, 3)
    if not 0 < len(table) <= _MOST_ROWS or (np.diff(table[:, 0]) <= 0.0).any():
        raise SimulatorError(f"{name}: 1 to {_MOST_ROWS} rows, ascending")
    return table
