"""A result file against a direct measurement, on files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from app.files.file_model import encode_json
from app.files.recorded_files import decode_reference
from app.files.result_file import read_result
from app.files.whole_files import write_files
from app.reporting.comparison_report import render_comparison_report
from app.results.comparison import ReferenceUncertainty, compare, compare_volumes
from app.results.comparison_files import comparison_csv, comparison_json

COMPARISON, TABLE, PAGE = "comparison.json", "comparison.csv", "comparison.html"


def compare_files(
    result: str | Path,
    reference: str | Path,
    folder: str | Path,
    instrument: ReferenceUncertainty,
) -> dict[str, Any]:
    """Compare and write the three files into a folder; return the content of the JSON.

    Raises BundleError with the place, BadInput if nothing can be compared.
    """
    loaded = read_result(result)
    direct = decode_reference(Path(reference).read_bytes(), file=str(reference))
    comparison = compare(loaded, direct, instrument)
    volume = compare_volumes(loaded.machine, comparison)
    names = {
        "machine": loaded.machine.name,
        "result": Path(result).name,
        "reference": Path(reference).name,
    }
    content = comparison_json(comparison, volume, names)
    page = render_comparison_report(loaded.machine, comparison, volume, names)
    files = {
        TABLE: comparison_csv(comparison).encode(),
        PAGE: page.encode(),
        COMPARISON: encode_json(content),
    }
    write_files(Path(folder), files)
    return content
