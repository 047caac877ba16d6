"""Fanuc: stored pitch error compensation, data and parameters as NC tapes.

Values are increments from one point to the next in small integers, so the running sum
is rounded, not each increment. Point number `3620` is the reference point; number k is
that of the section that ends k − 3620 intervals above it, and comes out as a step in
its middle; with interpolation, an option, it is spread over the section. A
magnification keeps increments at 7 or below, which every control of this make takes.

With `3605`#0 negative travel has increments of its own, from number `3626` on, and
`3627` is their amount at the reference point; they count from the negative end as well.
Their magnification is 1: no text at hand says whether it holds for 3627.

The sign is assumed to be that of what is added to the command, and has to be tried at
the machine. Source: FANUC B-63980EN, page 100; A-77810E, parameters 3605 to 3627.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float64

from truepath.app.compensation.fanuc_reading import read_pitch_tables
from truepath.app.compensation.format import (
    AxisTable,
    CompensationTables,
    InterpolatedTable,
    TableFormat,
)
from truepath.app.errors import BadInput
from truepath.app.kinematics.effects.error_motion import reference_position_mm
from truepath.app.kinematics.machine import Machine

UNIT_MM = 0.001
_LARGEST, _MOST = 7, 100  # of an increment; of the magnification
FIRST_DATA = 10_000  # data number of point 0
_LEAST_MM = 5e-4  # of lost motion that has increments: half a detection unit
_DIRECTIONS = ("both", "mean")


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
            "direction. "
        ) + (
            "Axes with 3605#0 = 1 need bidirectional pitch error compensation, an "
            "option of the control, and backlash (1851) 0; --directions mean does "
            "without"
            if directions == "both"
            else "The mean of both directions: backlash is for parameter 1851"
        )

    def write(self, content: CompensationTables) -> dict[str, str]:
        """Return data and parameters of all axes."""
        tapes: list[_Tape] = []
        for table in content.tables:
            first = tapes[-1].end + 2 if tapes else 1  # one for the reference
            tapes.append(_make_tape(table, first, both=self._directions == "both"))
        data = [f"N{FIRST_DATA + k}P{step}" for tape in tapes for k, step in tape.data]
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

    def read_tables(
        self, files: Mapping[str, str], machine: Machine
    ) -> Iterator[InterpolatedTable]:
        """Yield the summed increments of each axis, in mm."""
        return read_pitch_tables(files, machine)


@dataclass(frozen=True, slots=True)
class _Tape:
    """One axis: point numbers, interval, magnification, increments in order.

    backward : of negative travel, none where the others hold for it
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
        """Last point of positive travel; those of negative travel begin beyond it."""
        return self.first + len(self.forward) - 1

    @property
    def end(self) -> int:
        return self.last + len(self.backward)

    @property
    def data(self) -> list[tuple[int, int]]:
        """Increments by number of their point."""
        return list(enumerate((*self.forward, *self.backward), self.first))


def _make_tape(table: AxisTable, first: int, *, both: bool) -> _Tape:
    zero = reference_position_mm(table.axis)
    interval = _choose_interval_mm(table, zero)
    below = math.ceil((zero - table.axis.low) / interval - 1e-9)
    above = math.ceil((table.axis.high - zero) / interval - 1e-9)
    at = zero + interval * np.arange(-below, above + 1)
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
        sums = np.rint(wanted / (UNIT_MM * magnification)).astype(int)
        if np.abs(np.diff(sums)).max() <= _LARGEST:
            return _Tape(first, reference, interval, magnification, _steps(sums))
    sums = _round(table, wanted, _MOST)
    return _Tape(first, reference, interval, _MOST, _steps(sums))


def _round(
    table: AxisTable, wanted_mm: Float64[np.ndarray, " n"], magnification: int
) -> np.ndarray:
    """Return sums in whole units. Raises BadInput where one step is too large."""
    sums = np.rint(wanted_mm / (UNIT_MM * magnification)).astype(int)
    if np.abs(np.diff(sums)).max() > _LARGEST:
        raise BadInput(
            f"{table.axis.name} errs by more than {_LARGEST * magnification} µm from "
            "one point to the next; export with a smaller spacing"
        )
    return sums


def _steps(sums: np.ndarray) -> tuple[int, ...]:
    return tuple(int(step) for step in np.diff(sums))


def _choose_interval_mm(table: AxisTable, zero_mm: float) -> float:
    """Return an interval of whole micrometres, both ends of the travel on points.

    Where none down to half the spacing does that, the last points are beyond the ends.
    """
    below, above = (
        round((end - start) / UNIT_MM)
        for start, end in ((table.axis.low, zero_mm), (zero_mm, table.axis.high))
    )
    common, spacing = math.gcd(below, above), table.spacing_mm / UNIT_MM
    most = Fanuc.most_points - 1
    for count in range(
        math.ceil(common / spacing - 1e-6), int(2 * common / spacing) + 1
    ):
        if count and common % count == 0 and (below + above) * count <= most * common:
            return common // count * UNIT_MM
    return math.ceil(spacing - 1e-6) * UNIT_MM
