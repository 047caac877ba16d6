"""The files of an analysis: result, tables and report; predictions from a result."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from app.errors import BundleError
from app.files.file_model import encode_json
from app.files.result_file import LARGEST_BYTES, read_result
from app.files.run import Run
from app.files.whole_files import read_whole, replace_file, write_files
from app.reporting.calibration_report import render_calibration_report
from app.results.error_table_files import error_tables_csv
from app.results.findings import Findings
from app.results.points_csv import encode_predictions, read_points
from app.results.prediction import Prediction, predict
from app.results.result_json import result_json

RESULT, TABLES, REPORT = "result.json", "error_tables.csv", "report.html"


@dataclass(frozen=True, slots=True)
class Analysis:
    """What a result states, as the contents of its files.

    result : content of `result.json`; the others are texts of the files of that name
    """

    found: Findings
    result: dict[str, Any]
    tables_csv: str
    report_html: str


def render_analysis(found: Findings) -> Analysis:
    """Return the contents of the files of a result."""
    return Analysis(
        found,
        result_json(found),
        error_tables_csv(found.tables),
        render_calibration_report(found),
    )


def read_runs(
    places: Sequence[str | Path], read: Callable[[Path], Run]
) -> tuple[Run, ...]:
    """Read Runs. Raises BundleError, of several with the place of the one meant."""
    return tuple(_read(Path(place), read, len(places)) for place in places)


def _read(place: Path, read: Callable[[Path], Run], count: int) -> Run:
    try:
        return read(place)
    except BundleError as error:
        if count == 1:
            raise
        raise BundleError(
            error.problem,
            file=f"{place.name}: {error.file}",
            row=error.row,
            column=error.column,
            remedy=error.remedy,
        ) from error


def write_analysis(analysis: Analysis, folder: str | Path) -> None:
    """Write `result.json`, `error_tables.csv` and `report.html` into a folder."""
    # The result last: where it stands, the others stand as well.
    files = {
        TABLES: analysis.tables_csv.encode(),
        REPORT: analysis.report_html.encode(),
        RESULT: encode_json(analysis.result),
    }
    write_files(Path(folder), files)


def predict_points(
    result: str | Path, points: str | Path, output: str | Path
) -> Prediction:
    """Predict at the points of a CSV file from a result file, and write the answer.

    Raises BundleError with the place; `Prediction.warnings` is for the user.
    """
    calibration = read_result(result)
    data = read_whole(points, largest_bytes=LARGEST_BYTES)
    asked = read_points(data, calibration.machine, file=str(points))
    predicted = predict(calibration, asked.position, asked.target)
    replace_file(Path(output), encode_predictions(asked, predicted).encode())
    return predicted
