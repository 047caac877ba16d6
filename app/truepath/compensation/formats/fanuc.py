"""Fanuc: stored pitch error compensation, data and parameters as NC tapes.

Values are increments from one point to the next in small integers, so the running sum
is rounded, not each increment. Point number `3620` is the reference point, at machine
position 0 by the default of parameter 1240; where that is out of the travel, increments
of 0 lead to it. Number k is that of the section that ends k − 3620 intervals above it,
and comes out as a step in its middle; with interpolation, an option, it is spread over
the section. A magnification keeps increments at 7 or below, which every control of this
make accepts.

With `3605`#0 negative travel has separate increments, from number `3626` on, and
`3627` is their amount at the reference point; they count from the negative end as well.
Their magnification is 1: no text at hand says whether it holds for 3627.

Points have the numbers 0 to 1023 for all axes together, those of negative travel among
them: if they do not suffice, the sections of all axes are longer.

The sign is assumed to be that of what is added to the command, and has to be tried at
the machine. Source: FANUC B-63980EN, page 100; A-77810E, parameters 3605 to 3627.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import ClassVar

import numpy as np
from jaxtyping import Float64

from truepath.compensation.format import (
    AxisTable,
    CompensationTables,
    Files,
    InterpolatedTable,
    TableFormat,
)
from truepath.errors import BadInput
from truepath.kinematics.machine.machine import LinearAxis, Machine
from truepath.kinematics.machine.symbols import LINEAR

_UNIT_MM = 0.001
_LARGEST, _MOST = 7, 100  # of an increment; of the magnification
_LAST_POINT = 1023  # of all axes; the first is 0
_FIRST_DATA = 10_000  # data number of point 0
_LEAST_MM = 5e-4  # of lost motion that has increments: half a detection unit
_WIDER = 1.01  # spacing by spacing, until the points of all axes have numbers
_DIRECTIONS = ("both", "mean")
_DATA = re.compile(r"N(\d+)P(-?\d+)")
_WORDS = re.compile(r"A(\d)P([\d.-]+)")


class Fanuc(TableFormat):
    """Positioning of each axis: `STEM-pitch.txt` and `STEM-parameters.txt`."""

    control = "Fanuc, stored pitch error compensation"
    suffix = ".txt"
    most_points = 300
    resolution_um = 1.0
    carries = "positioning of each axis, in both directions where it loses motion"
    not_carried = (
        "straightness, angular errors, squareness, lost motion across or about an axis"
    )
    units = "detection units of 1 um, positions mm"
    sign = "the sum of the increments is added to the command"
    sign_is_verified = False
    choices: ClassVar[Mapping[str, tuple[str, ...]]] = {"directions": _DIRECTIONS}

    def __init__(self, directions: str = _DIRECTIONS[0]) -> None:
        self._directions = directions
        if directions == "both":
            self.directions = "each by itself where an axis loses motion"
        self.note = (
            "A1, A2, A3 are X, Y, Z, detection unit 1 µm; parameters first, then the "
            "data; switch power off and on and return to the reference point, in + "
            "direction. It is taken to be at machine position 0 of each axis, as with "
            "1240 = 0: from another one the files are off by as much. Points 0 to "
            f"{_LAST_POINT} are those of all axes of the control: of other axes they "
            "have to stand beyond those used here. "
        ) + (
            "Axes with 3605#0 = 1 need bidirectional pitch error compensation, an "
            "option of the control, and backlash (1851) 0; --directions mean does "
            "without"
            if directions == "both"
            else "The mean of both directions: backlash is for parameter 1851"
        )

    def limit_rows(
        self, axes: Sequence[LinearAxis], spacing_mm: float
    ) -> Mapping[str, int]:
        """The same spacing for all axes, given by the number of points."""
        sets, spacing = 2 if self._directions == "both" else 1, spacing_mm
        while True:
            rows = {
                axis.name: min(
                    max(2, math.ceil((axis.high - axis.low) / spacing - 1e-9) + 1),
                    self.most_points,
                )
                for axis in axes
            }
            # One section more, where both ends are beyond the travel.
            points = [_count_sections(axis, rows[axis.name]) + 1 for axis in axes]
            if sum(1 + sets * count for count in points) <= _LAST_POINT + 1:
                return rows
            spacing *= _WIDER

    def write(self, content: CompensationTables) -> dict[str, str]:
        """Data and parameters of all axes. Raises BadInput."""
        tapes = self._make_tapes(content.tables)
        data = [f"N{_FIRST_DATA + k}P{step}" for tape in tapes for k, step in tape.data]
        parameters = [
            f"N0{number}" + "".join(f"A{i + 1}P{w}" for i, w in enumerate(words))
            for number, words in (
                (3605, [f"{int(t.is_bidirectional):08d}" for t in tapes]),
                (3620, [t.reference for t in tapes]),
                (3621, [t.first for t in tapes]),
                (3622, [t.last for t in tapes]),
                (3623, [t.magnification for t in tapes]),
                (3624, [f"{t.interval_mm:.3f}" for t in tapes]),
                (3626, [t.last + 1 if t.is_bidirectional else 0 for t in tapes]),
                (3627, [t.amount for t in tapes]),
            )
        ]
        stem = content.stem
        return {
            f"{stem}-pitch{self.suffix}": "\n".join(["%", *data, "%", ""]),
            f"{stem}-parameters{self.suffix}": "\n".join(["%", *parameters, "%", ""]),
        }

    def _make_tapes(self, tables: Sequence[AxisTable]) -> list[_Tape]:
        """Each tape continues the numbers of the one before. Raises BadInput."""
        tapes: list[_Tape] = []
        for choose in (_choose_interval_mm, _round_spacing_mm):
            tapes = []
            for table in tables:
                first = tapes[-1].end + 2 if tapes else 1  # one for the reference
                both = self._directions == "both"
                tapes.append(_make_tape(table, choose(table), first, both=both))
            if tapes[-1].end <= _LAST_POINT:
                return tapes
        used = ", ".join(
            f"{table.axis.name} {tape.describe()}"
            for table, tape in zip(tables, tapes, strict=True)
        )
        raise BadInput(
            f"the control numbers the points of all axes 0 to {_LAST_POINT}; these "
            f"tables need {tapes[-1].end + 1}: {used}; export with a wider spacing"
        )

    def read_tables(
        self, files: Files, machine: Machine
    ) -> Iterator[InterpolatedTable]:
        """Summed increments of each axis, mm.

        The reference point is at machine position 0.
        """
        data = _read_data(_find_tape(files, "-pitch"))
        words = _read_parameters(_find_tape(files, "-parameters"))
        for index, axis in enumerate(machine.linear_axes):
            yield _sum_increments(axis.name, index, data, words)


@dataclass(frozen=True, slots=True)
class _Tape:
    """One axis: point numbers, interval, magnification, increments in order.

    backward : of negative travel, empty where the others hold for it
    amount : of negative travel at the reference point, detection units
    """

    first: int
    reference: int
    interval_mm: float
    magnification: int
    forward: tuple[int, ...]
    backward: tuple[int, ...] = ()
    amount: int = 0

    @property
    def is_bidirectional(self) -> bool:
        return bool(self.backward)

    @property
    def last(self) -> int:
        return self.first + len(self.forward) - 1

    @property
    def end(self) -> int:
        return self.last + len(self.backward)

    def describe(self) -> str:
        twice = ", twice" if self.is_bidirectional else ""
        return f"{len(self.forward)} sections of {self.interval_mm:g} mm{twice}"

    @property
    def data(self) -> list[tuple[int, int]]:
        return list(enumerate((*self.forward, *self.backward), self.first))


def _make_tape(table: AxisTable, interval: float, first: int, *, both: bool) -> _Tape:
    low, high = _compute_span_mm(table.axis)
    below, above = (math.ceil(end / interval - 1e-9) for end in (-low, high))
    at = interval * np.arange(-below, above + 1)
    own, reference = table.own, first + below - 1
    lost = (table.forward_mm - table.backward_mm)[:, own]
    if both and np.abs(lost).max() > _LEAST_MM:
        up, down = (
            _round(table, -np.interp(at, table.position_mm, value[:, own]), 1)
            for value in (table.forward_mm, table.backward_mm)
        )
        amount = int(down[below] - up[below])
        return _Tape(first, reference, interval, 1, _steps(up), _steps(down), amount)
    error = np.interp(at, table.position_mm, table.mean_mm[:, own])
    wanted = error[below] - error
    for magnification in range(1, _MOST):
        sums = np.rint(wanted / (_UNIT_MM * magnification)).astype(int)
        if np.abs(np.diff(sums)).max() <= _LARGEST:
            return _Tape(first, reference, interval, magnification, _steps(sums))
    sums = _round(table, wanted, _MOST)
    return _Tape(first, reference, interval, _MOST, _steps(sums))


def _round(
    table: AxisTable, wanted_mm: Float64[np.ndarray, " n"], magnification: int
) -> np.ndarray:
    """Sums in whole units. Raises BadInput where one step is too large."""
    sums = np.rint(wanted_mm / (_UNIT_MM * magnification)).astype(int)
    if np.abs(np.diff(sums)).max() > _LARGEST:
        mean = ", or directions mean, which has one" if magnification == 1 else ""
        raise BadInput(
            f"{table.axis.name} errs by more than {_LARGEST * magnification} µm from "
            f"one point to the next, at magnification {magnification}; export with a "
            f"smaller spacing{mean}"
        )
    return sums


def _steps(sums: np.ndarray) -> tuple[int, ...]:
    return tuple(int(step) for step in np.diff(sums))


def _choose_interval_mm(table: AxisTable) -> float:
    """Interval of whole micrometres, with both ends of the travel on points.

    If none down to half the spacing does that, the last points are beyond the ends.
    """
    low, high = _compute_span_mm(table.axis)
    below, above = round(-low / _UNIT_MM), round(high / _UNIT_MM)
    common, spacing = math.gcd(below, above), table.spacing_mm / _UNIT_MM
    most = Fanuc.most_points - 1
    for count in range(
        math.ceil(common / spacing - 1e-6), int(2 * common / spacing) + 1
    ):
        if count and common % count == 0 and (below + above) * count <= most * common:
            return common // count * _UNIT_MM
    return _round_spacing_mm(table)


def _round_spacing_mm(table: AxisTable) -> float:
    low, high = _compute_span_mm(table.axis)
    spacing_mm = max(table.spacing_mm, (high - low) / (Fanuc.most_points - 1))
    return math.ceil(spacing_mm / _UNIT_MM - 1e-6) * _UNIT_MM


def _count_sections(axis: LinearAxis, rows: int) -> int:
    low, high = _compute_span_mm(axis)
    share = (high - low) / (axis.high - axis.low)
    return min(math.ceil((rows - 1) * share - 1e-9), Fanuc.most_points - 1)


def _compute_span_mm(axis: LinearAxis) -> tuple[float, float]:
    """Ends of the travel, extended to the reference point."""
    return min(axis.low, 0.0), max(axis.high, 0.0)


def _sum_increments(
    name: str,
    index: int,
    data: dict[int, int],
    words: dict[tuple[int, int], float],
) -> InterpolatedTable:
    zero, first, last, magnification, interval = (
        words[number, index] for number in (3620, 3621, 3622, 3623, 3624)
    )
    below = int(zero - first) + 1  # intervals under the reference point
    unit = magnification * _UNIT_MM

    def add_up(begin: int) -> np.ndarray:
        numbers = range(begin, begin + int(last - first) + 1)
        sums = np.concatenate([[0.0], np.cumsum([data[number] for number in numbers])])
        return unit * (sums - sums[below])

    forward = add_up(int(first))
    at = interval * (np.arange(len(forward)) - below)
    backward = None
    if words.get((3605, index), 0.0) % 10 == 1:
        amount = _UNIT_MM * words[3627, index]
        backward = add_up(int(words[3626, index])) + amount
    own = LINEAR.index(name)
    return InterpolatedTable(name, own, at, forward, backward, is_stepped=True)


def _find_tape(files: Files, part: str) -> list[str]:
    named = [text for name, text in files.items() if PurePath(name).stem.endswith(part)]
    if not named:
        raise BadInput(f"no file of {', '.join(files)} has a name that ends in {part}")
    lines = named[0].split()
    if len(lines) < 3 or lines[0] != "%" or lines[-1] != "%":
        raise BadInput("a tape stands between two %")
    return lines[1:-1]


def _read_data(lines: list[str]) -> dict[int, int]:
    rows = [_DATA.fullmatch(line) for line in lines]
    if None in rows:
        raise BadInput("pitch data are rows N…P…")
    return {int(m.group(1)) - _FIRST_DATA: int(m.group(2)) for m in rows if m}


def _read_parameters(lines: list[str]) -> dict[tuple[int, int], float]:
    return {
        (int(line[1:6]), int(axis) - 1): float(value)
        for line in lines
        for axis, value in _WORDS.findall(line[6:])
    }
