"""Points to predict at, and what is predicted there, as CSV.

In: a column for every axis (`x_mm,y_mm,z_mm`), and whatever else. A machine with named
targets may name one a point in the column `target`. Out: the same columns as they came,
then the volumetric error with its standard uncertainty (k = 1).
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.errors import BundleError
from app.files.tables import Table, read_csv
from app.kinematics.machine import LinearAxis, Machine
from app.results.prediction import Prediction

PREDICTED = ("dx_um", "dy_um", "dz_um", "ux_um", "uy_um", "uz_um")
_FARTHEST = 1e6  # mm or deg: what lies farther is not a position of a machine tool


@dataclass(frozen=True, slots=True)
class Points:
    """Points of a file.

    position : (n, axes), mm for linear and deg for rotary axes; table : as it came
    target : the target of each point; empty where the file names none
    """

    position: Float64[np.ndarray, "n a"]
    target: tuple[str, ...]
    table: Table


def read_points(data: bytes, machine: Machine, *, file: str = "points.csv") -> Points:
    """Return the points of a CSV file. Raises BundleError with row and column."""
    table = read_csv(data, file)
    columns = [_read_numbers(table, name) for name in _name_columns(machine)]
    if not len(table):
        raise BundleError("has no rows", file=file, remedy="name at least one point")
    return Points(np.stack(columns, axis=1), _read_targets(table, machine), table)


def encode_predictions(points: Points, predicted: Prediction) -> str:
    """Return the file of predictions at the points."""
    sink = io.StringIO()
    writer = csv.writer(sink, lineterminator="\n")
    kept = [name for name in points.table.names if name not in PREDICTED]
    writer.writerow([*kept, *PREDICTED])
    given = [points.table.cells(name) for name in kept]
    writer.writerows(
        [*words, *numbers]
        for words, numbers in zip(
            zip(*given, strict=True), _format_rows(predicted), strict=True
        )
    )
    return sink.getvalue()


def _format_rows(predicted: Prediction) -> Iterator[list[str]]:
    both = np.hstack([predicted.error_um, predicted.uncertainty_um])
    for row in both.tolist():
        yield [f"{value:z.5f}" for value in row]


def _name_columns(machine: Machine) -> list[str]:
    return [
        f"{axis.name.lower()}_{'mm' if isinstance(axis, LinearAxis) else 'deg'}"
        for axis in machine.axes
    ]


def _read_numbers(table: Table, name: str) -> Float64[np.ndarray, " n"]:
    values = table.numbers(name)
    far = np.abs(values) > _FARTHEST
    if far.any():
        index = int(np.argmax(far))
        raise table.error(
            f"is {values[index]:g}, no position of a machine",
            index,
            name,
            f"check the unit, {name.rpartition('_')[2]}",
        )
    return values


def _read_targets(table: Table, machine: Machine) -> tuple[str, ...]:
    known = [target.name for target in machine.targets if target.name]
    if "target" not in table.names or not known:
        return ()
    names = table.texts("target")
    for index, name in enumerate(names):
        if name not in known:
            raise table.error(
                f"is {name!r}, unknown",
                index,
                "target",
                f"the result has {', '.join(known)}",
            )
    return tuple(names)
