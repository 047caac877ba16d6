"""Fanuc: stored pitch error compensation, data and parameters as NC tapes.

Values are increments from one point to the next in small integers, so the running sum
is rounded, not each increment. Point number `3620` is the reference point; number k is
the interval that ends k − 3620 intervals above it. A magnification keeps increments at
7 or below, which every control of this make takes. The sign is assumed to be that of
what is added to the command, and has to be tried at the machine. Source: FANUC A-77810E
and parameter manuals (3620 to 3624).
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from truepath.app.compensation.format import (
    AxisTable,
    CompensationTables,
    InterpolatedTable,
    TableFormat,
)
from truepath.app.errors import BadInput
from truepath.app.kinematics.effects.error_motion import reference_position_mm
from truepath.app.kinematics.machine import Machine
from truepath.app.kinematics.symbols import LINEAR

_UNIT_MM = 0.001
_LARGEST, _MOST = 7, 100  # of an increment; of the magnification
_FIRST = 10_000  # data number of point 0


class Fanuc(TableFormat):
    """Positioning of each axis: `STEM-pitch.txt` and `STEM-parameters.txt`."""

    control = "Fanuc, stored pitch error compensation"
    suffix = ".txt"
    most_points = 300
    resolution_um = 1.0
    carries = "positioning of each axis, mean of both directions"
    not_carried = (
        "backlash (parameter 1851 has it), straightness, angular errors, squareness"
    )
    sign = "the sum of the increments is added to the command"
    sign_is_verified = False
    note = (
        "A1, A2, A3 are X, Y, Z, detection unit 1 µm; parameters first, then the data; "
        "switch power off and on and return to the reference point"
    )

    def write(self, content: CompensationTables) -> dict[str, str]:
        """Return data and parameters of all axes."""
        tapes: list[_Tape] = []
        for table in content.tables:
            first = tapes[-1].last + 2 if tapes else 1  # one for the reference
            tapes.append(_make_tape(table, first))
        data = [
            f"N{_FIRST + tape.first + k}P{step}"
            for tape in tapes
            for k, step in enumerate(tape.increments)
        ]
        parameters = [
            f"N0{number}" + "".join(f"A{i + 1}P{w}" for i, w in enumerate(words))
            for number, words in (
                (3620, [t.reference for t in tapes]),
                (3621, [t.first for t in tapes]),
                (3622, [t.last for t in tapes]),
                (3623, [t.magnification for t in tapes]),
                (3624, [f"{t.interval_mm:.3f}" for t in tapes]),
            )
        ]
        return {
            f"{content.stem}-pitch{self.suffix}": "\n".join(["%", *data, "%", ""]),
            f"{content.stem}-parameters{self.suffix}": "\n".join(
                ["%", *parameters, "%", ""]
            ),
        }

    def read_tables(
        self, files: Mapping[str, str], machine: Machine
    ) -> Iterator[InterpolatedTable]:
        """Yield the summed increments of each axis, in mm."""
        data, parameters = (
            next(_split_tape(text) for name, text in files.items() if part in name)
            for part in ("-pitch", "-parameters")
        )
        return _sum_increments(_read_data(data), _read_parameters(parameters), machine)


@dataclass(frozen=True, slots=True)
class _Tape:
    """One axis: point numbers, interval, magnification, increments in order."""

    first: int
    reference: int
    interval_mm: float
    magnification: int
    increments: tuple[int, ...]

    @property
    def last(self) -> int:
        return self.first + len(self.increments) - 1


def _make_tape(table: AxisTable, first: int) -> _Tape:
    zero = reference_position_mm(table.axis)
    interval = math.ceil(table.spacing_mm * 1e3) / 1e3  # the parameter's resolution
    below = math.ceil((zero - table.axis.low) / interval - 1e-9)
    above = math.ceil((table.axis.high - zero) / interval - 1e-9)
    at = zero + interval * np.arange(-below, above + 1)
    error = np.interp(at, table.position_mm, table.mean_mm[:, table.own])
    wanted: Float64[np.ndarray, " n"] = error[below] - error
    for magnification in range(1, _MOST + 1):
        sums = np.rint(wanted / (_UNIT_MM * magnification)).astype(int)
        steps = np.diff(sums)
        if np.abs(steps).max() <= _LARGEST:
            increments = tuple(int(step) for step in steps)
            return _Tape(first, first + below - 1, interval, magnification, increments)
    raise BadInput(
        f"{table.axis.name} errs by more than {_LARGEST * _MOST} µm from one point to "
        "the next; export with a smaller spacing"
    )


_DATA = re.compile(r"N(\d+)P(-?\d+)")
_WORDS = re.compile(r"A(\d)P([\d.-]+)")


def _split_tape(text: str) -> list[str]:
    lines = text.split()
    if len(lines) < 3 or lines[0] != "%" or lines[-1] != "%":
        raise BadInput("a tape stands between two %")
    return lines[1:-1]


def _read_data(lines: list[str]) -> dict[int, int]:
    rows = [_DATA.fullmatch(line) for line in lines]
    if None in rows:
        raise BadInput("pitch data are rows N…P…")
    return {int(m.group(1)) - _FIRST: int(m.group(2)) for m in rows if m}


def _read_parameters(lines: list[str]) -> dict[tuple[int, int], float]:
    return {
        (int(line[1:6]), int(axis) - 1): float(value)
        for line in lines
        for axis, value in _WORDS.findall(line[6:])
    }


def _sum_increments(
    data: dict[int, int], parameters: dict[tuple[int, int], float], machine: Machine
) -> Iterator[InterpolatedTable]:
    for index, axis in enumerate(machine.linear_axes):
        zero, first, last, magnification, interval = (
            parameters[number, index] for number in (3620, 3621, 3622, 3623, 3624)
        )
        numbers = range(int(first), int(last) + 1)
        increments = [data[number] for number in numbers]
        sums = np.concatenate([[0.0], np.cumsum(increments)]) * magnification * _UNIT_MM
        below = int(zero - first) + 1  # intervals under the reference point
        at = interval * (np.arange(len(sums)) - below) + reference_position_mm(axis)
        value = sums - sums[below]
        yield InterpolatedTable(axis.name, LINEAR.index(axis.name), at, value)
