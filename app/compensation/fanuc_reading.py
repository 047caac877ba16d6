"""What a Fanuc control makes of pitch data and parameters: an account of its own."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import PurePath

import numpy as np

from truepath.app.compensation.format import InterpolatedTable
from truepath.app.errors import BadInput
from truepath.app.kinematics.machine import Machine
from truepath.app.kinematics.symbols import LINEAR

_DATA = re.compile(r"N(\d+)P(-?\d+)")
_WORDS = re.compile(r"A(\d)P([\d.-]+)")
_UNIT_MM, _FIRST = 0.001, 10_000


def read_pitch_tables(
    files: Mapping[str, str], machine: Machine
) -> Iterator[InterpolatedTable]:
    """Yield the summed increments of each axis, in mm. Raises BadInput.

    The reference point is at machine position 0.
    """
    data, parameters = (_find_tape(files, part) for part in ("-pitch", "-parameters"))
    increments, words = _read_data(data), _read_parameters(parameters)
    for index, axis in enumerate(machine.linear_axes):
        yield _sum_increments(axis.name, index, increments, words)


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


def _find_tape(files: Mapping[str, str], part: str) -> list[str]:
    for name, text in files.items():
        if PurePath(name).stem.endswith(part):
            return _split_tape(text)
    raise BadInput(f"no file of {', '.join(files)} has a name that ends in {part}")


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
