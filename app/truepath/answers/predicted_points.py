"""Points to predict at, and the predictions there, as CSV.

In: a column for every axis (`x_mm,y_mm,z_mm`), and whatever else. A machine with named
targets may name one a point in the column `target`. Out: the same columns as they came,
then the volumetric error with its standard uncertainty (k = 1). Where the result is not
simply usable each row says so in a last column, `verdict`: rows are copied elsewhere.
"""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from truepath.documents.whole_files import read_whole, replace_file
from truepath.files.earlier.result_file import LARGEST_BYTES, read_result
from truepath.files.tables import Table, read_csv
from truepath.kinematics.machine.machine import Machine
from truepath.motion.configurations import name_columns
from truepath.results.prediction import Prediction, predict

_PREDICTED = ("dx_um", "dy_um", "dz_um", "ux_um", "uy_um", "uz_um")
_VERDICT = "verdict"
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


def predict_points(
    result: str | Path, points: str | Path, output: str | Path
) -> Prediction:
    """Predict at the points of a CSV file from a result file, and write them.

    Raises BundleError with the place; `Prediction.warnings` is for the user.
    """
    calibration = read_result(result)
    data = read_whole(points, largest_bytes=LARGEST_BYTES)
    requested = read_points(data, calibration.machine, file=str(points))
    predicted = predict(calibration, requested.position, requested.target)
    replace_file(Path(output), encode_predictions(requested, predicted).encode())
    return predicted


def read_points(data: bytes, machine: Machine, *, file: str = "points.csv") -> Points:
    """Raises BundleError with row and column."""
    table = read_csv(data, file)
    columns = [_read_numbers(table, name) for name in name_columns(machine.axis_names)]
    table.require_rows("name at least one point")
    target: tuple[str, ...] = ()
    known = [one.name for one in machine.targets if one.name]
    if known and "target" in table.names:
        remedy = f"the result has {', '.join(known)}"
        target = tuple(table.choices("target", known, remedy))
    return Points(np.stack(columns, axis=1), target, table)


def encode_predictions(points: Points, predicted: Prediction) -> str:
    """CSV: own columns of the points, µm with k = 1, and `verdict` if it objects."""
    sink = io.StringIO()
    writer = csv.writer(sink, lineterminator="\n")
    mark = [predicted.verdict.state] if predicted.verdict.objection else []
    own = {*_PREDICTED, _VERDICT}
    kept = [name for name in points.table.names if name not in own]
    writer.writerow([*kept, *_PREDICTED, *([_VERDICT] if mark else [])])
    given = [points.table.cells(name) for name in kept]
    numbers = np.hstack([predicted.error_um, predicted.uncertainty_um]).tolist()
    for *words, row in zip(*given, numbers, strict=True):
        writer.writerow([*words, *(f"{value:z.5f}" for value in row), *mark])
    return sink.getvalue()


def _read_numbers(table: Table, name: str) -> Float64[np.ndarray, " n"]:
    values = table.numbers(name)
    table.reject(
        np.abs(values) > _FARTHEST,
        name,
        lambda k: f"is {values[k]:g}, no position of a machine",
        f"check the unit, {name.rpartition('_')[2]}",
    )
    return values
