"""The files of an analysis: Runs in; result, tables and report out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from truepath.answers.calibration.calibration_report import render_calibration_report
from truepath.documents.file_model import encode_json
from truepath.documents.whole_files import write_files
from truepath.errors import BundleError
from truepath.files.bundle.run import Run
from truepath.results.error_table_files import error_tables_csv
from truepath.results.result_json import result_json
from truepath.results.result_summary import Findings

RESULT, TABLES, REPORT = "result.json", "error_tables.csv", "report.html"


@dataclass(frozen=True, slots=True)
class Analysis:
    """Contents of the files of an analysis.

    result : content of `result.json`; the others are texts of the files of that name
    """

    found: Findings
    result: dict[str, Any]
    tables_csv: str
    report_html: str


def render_analysis(found: Findings) -> Analysis:
    """`result.json`, `error_tables.csv` and `report.html`, not yet written."""
    return Analysis(
        found,
        result_json(found),
        error_tables_csv(found.tables, found.verdict),
        render_calibration_report(found),
    )


def read_runs(
    places: Sequence[str | Path], read: Callable[[Path], Run]
) -> tuple[Run, ...]:
    """Raises BundleError; of several Runs `file` begins with the name of that Run."""
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
    """`result.json`, `error_tables.csv` and `report.html` in a folder, each whole."""
    # The result last: where it exists, the others exist as well.
    files = {
        TABLES: analysis.tables_csv.encode(),
        REPORT: analysis.report_html.encode(),
        RESULT: encode_json(analysis.result),
    }
    write_files(Path(folder), files)
