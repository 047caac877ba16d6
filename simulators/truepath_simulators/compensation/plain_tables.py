"""Plain tables, CSV and JSON, as software between plan and controller would use them.

A row: axis, direction + or -, position in mm, shifts in µm, turns in µrad. At positions
of the axes the error of the tool is the sum over them of shift + turn × R, R the
positions of the axes nearer to the tool; the axes are sent to the command minus that.
Linear between rows; end values hold. Columns beyond these nine are of temperature,
which the software ignores.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from truepath_simulators.compensation.correction import Correction, Curve, Rules
from truepath_simulators.errors import SimulatorError
from truepath_simulators.machine_file import MachineFile

_MOTIONS = [*(f"{axis}_um" for axis in "xyz"), *(f"{turn}_urad" for turn in "abc")]
COLUMNS = ["axis", "direction", "position_mm", *_MOTIONS]
_SIDES = {"+": 1, "-": -1}
_MICRO = 1e-3, 1e-6  # mm in a µm, rad in a µrad


@dataclass(frozen=True, slots=True)
class PlainCorrection(Correction):
    """Minus the error of the rows, carried through the chain.

    order : columns of the axes, from the workpiece to the tool
    curves : by column, three shifts in mm and three turns in rad of each direction
    """

    order: tuple[int, ...]
    curves: Mapping[int, tuple[tuple[Curve, ...], ...]]

    def added(self, position: np.ndarray, heading: np.ndarray) -> np.ndarray:
        total = np.zeros_like(position, dtype=float)
        for place, column in enumerate(self.order):
            beyond = np.zeros((len(position), 3))
            nearer = list(self.order[place + 1 :])
            beyond[:, nearer] = position[:, nearer]
            motion = np.stack(
                [
                    sum(curve.read(position, heading) for curve in both)
                    for both in self.curves.get(column, ())
                ]
                or [np.zeros(len(position))] * 6,
                axis=1,
            )
            total -= motion[:, :3] + np.cross(motion[:, 3:], beyond)
        return total


def read_plain(
    name: str, text: str, machine: MachineFile, rules: Rules
) -> PlainCorrection:
    """Correction by the software; the format is determined by the first character."""
    del rules
    if machine.axis_names != ("X", "Y", "Z"):
        raise SimulatorError(f"{name}: plain tables are simulated of X, Y and Z alone")
    try:
        head, rows = _split_json(text) if text.startswith("{") else _split_csv(text)
        if head[: len(COLUMNS)] != COLUMNS:
            raise ValueError(f"the columns are not {', '.join(COLUMNS)}")
        found: dict[tuple[int, int], list[list[float]]] = {}
        for axis, side, *numbers in rows:
            key = machine.axis_names.index(str(axis)), _SIDES[str(side)]
            found.setdefault(key, []).append([float(number) for number in numbers[:7]])
        curves = {
            column: _make_curves(column, found) for column in {c for c, _ in found}
        }
    except (ValueError, LookupError, TypeError) as error:
        raise SimulatorError(f"{name}: no plain table ({error})") from error
    chain = machine.workpiece_side + machine.tool_side
    order = tuple(machine.axis_names.index(axis) for axis in chain)
    return PlainCorrection(order, curves)


def _split_csv(text: str) -> tuple[list[str], Iterable[list[str]]]:
    lines = [line for line in text.splitlines() if line and not line.startswith("#")]
    head, *rows = csv.reader(lines)
    return head, rows


def _split_json(text: str) -> tuple[list[str], Iterable[list[str]]]:
    document = json.loads(text)
    return list(document["columns"]), document["rows"]


def _make_curves(
    column: int, found: Mapping[tuple[int, int], list[list[float]]]
) -> tuple[tuple[Curve, ...], ...]:
    by_side = {side: np.array(found[column, side]) for side in _SIDES.values()}
    return tuple(
        tuple(
            Curve(column, rows[:, 0], _MICRO[k // 3] * rows[:, 1 + k], side)
            for side, rows in by_side.items()
        )
        for k in range(6)
    )
