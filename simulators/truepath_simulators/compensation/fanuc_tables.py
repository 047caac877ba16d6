"""Fanuc: stored pitch error compensation, data `N1xxxxP…` and parameters 3605 to 3627.

Data are increments in detection units times the magnification, of the sections between
points: number 3620 is that of the section that ends at the reference point, at machine
position 0. The value of a section comes out at its middle, as a step; with
interpolation, an option of the control, it is spread over it. With 3605#0 there is a
second set for travel in the negative direction, from number 3626 on, 3627 being its
amount at the reference point; increments count from the negative end in both.
Source: B-63980EN, page 100; A-77810E.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping

import numpy as np

from truepath_simulators.compensation.correction import Curve, Term
from truepath_simulators.errors import SimulatorError
from truepath_simulators.machine_file import MachineFile

_FIRST_DATA = 10_000
_UNIT = 1e-3  # mm or deg
_LINE = re.compile(r"N(\d+)((?:A\d+)?P.*)")
_WORD = re.compile(r"(?:A(\d+))?P(-?[\d.]+)")
Parameters = dict[tuple[int, int], str]


def read_fanuc(files: Mapping[str, str], machine: MachineFile) -> Iterator[Term]:
    """Corrections by data and parameters; axis numbers in the order of the columns."""
    data: dict[int, int] = {}
    parameters: Parameters = {}
    for name, text in files.items():
        _read_tape(name, text, data, parameters)
    for column in range(len(machine.axes)):
        if (3620, column + 1) in parameters:
            yield from _read_axis(column, data, parameters)


def _read_tape(
    name: str, text: str, data: dict[int, int], parameters: Parameters
) -> None:
    for number, line in enumerate(text.split(), 1):
        if line == "%":
            continue
        found = _LINE.fullmatch(line)
        if found is None:
            raise SimulatorError(f"{name}, row {number}: {line!r} is not understood")
        label = int(found.group(1))
        for axis, value in _WORD.findall(found.group(2)):
            if axis:
                parameters[label, int(axis)] = value
            else:
                data[label - _FIRST_DATA] = int(value)


def _read_axis(
    column: int, data: dict[int, int], parameters: Parameters
) -> Iterator[Term]:
    def number(parameter: int) -> float:
        try:
            return float(parameters[parameter, column + 1])
        except KeyError as error:
            raise SimulatorError(
                f"parameter {parameter} of axis {column + 1} is missing"
            ) from error

    reference, first, last = (int(number(p)) for p in (3620, 3621, 3622))
    unit, interval = _UNIT * number(3623), number(3624)
    turn = float(parameters.get((3625, column + 1), "0"))

    def make_curve(begin: int, amount: float, side: int) -> Curve:
        steps = [data.get(begin + k, 0) for k in range(last - first + 1)]
        sums = np.concatenate([[0.0], np.cumsum(steps)])
        below = reference - first + 1
        at = interval * (np.arange(len(sums)) - below)
        value = unit * (sums - sums[below]) + amount
        return Curve(column, at, value, side, turn, is_stepped=True)

    is_bidirectional = parameters.get((3605, column + 1), "0")[-1] == "1"
    if not is_bidirectional:
        yield Term(column, (make_curve(first, 0.0, 0),))
        return
    yield Term(column, (make_curve(first, 0.0, 1),))
    amount = _UNIT * number(3627)
    yield Term(column, (make_curve(int(number(3626)), amount, -1),))
