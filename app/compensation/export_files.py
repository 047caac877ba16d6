"""A result file as a controller's compensation files, on disk."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from app.compensation.error_map import map_errors
from app.compensation.export import SPACING_MM, export_result, find_suffix
from app.files.file_model import encode_json
from app.files.result_file import read_result
from app.files.whole_files import replace_file

ACCOUNT = ".json"


def export_files(
    result: str | Path,
    name: str,
    output: str | Path,
    *,
    spacing_mm: float = SPACING_MM,
) -> dict[str, Any]:
    """Write the files of a format beside `output`, and their account as `STEM.json`.

    A single file is written to `output` itself; the names of several begin with the
    stem of `output`. Returns the account, `files` as paths.

    Raises BundleError with the place in the result, BadInput as `export_result`.
    """
    suffix = find_suffix(name)
    place = Path(output)
    export = export_result(
        map_errors(read_result(result)),
        name,
        place.stem,
        spacing_mm=spacing_mm,
    )
    place.parent.mkdir(parents=True, exist_ok=True)
    alone = len(export.files) == 1 and place.suffix not in ("", suffix)
    written: list[Path] = []
    for file, text in export.files.items():
        target = place if alone else place.parent / file
        replace_file(target, text.encode("ascii"))
        written.append(target)
    account = {**export.account, "files": [str(path) for path in written]}
    beside = place.parent / f"{place.stem}{ACCOUNT}"
    replace_file(beside, encode_json(account, indent=1))
    return account
