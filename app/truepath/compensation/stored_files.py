"""Compensation files that are stored with the result from which they were made."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from truepath.errors import NotFound

STEM = "compensation"
ACCOUNT = f"{STEM}.json"  # written last: if it is there, all files are


def read_account(folder: Path, name: str) -> dict[str, Any]:
    """Account of stored files, `files` as names. Raises NotFound."""
    place = _find_kept(folder).get(name)
    if place is None:
        raise NotFound(f"no compensation {name!r} is kept here")
    account = json.loads((place / ACCOUNT).read_text(encoding="utf-8"))
    return {**account, "files": [Path(file).name for file in account["files"]]}


def list_accounts(folder: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    """Name and account of all stored files, in the order of their names."""
    for name in sorted(_find_kept(folder)):
        yield name, read_account(folder, name)


def find_file(folder: Path, name: str, file: str) -> Path:
    """Path of one of the files, or of their account. Raises NotFound."""
    if file not in (*read_account(folder, name)["files"], ACCOUNT):
        raise NotFound(f"compensation {name!r} has no file {file!r}")
    return folder / name / file


def pack_files(folder: Path, name: str) -> bytes:
    """All files and their account as a ZIP archive. Raises NotFound."""
    names = (*read_account(folder, name)["files"], ACCOUNT)
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in names:
            archive.write(folder / name / file, file)
    return packed.getvalue()


def _find_kept(folder: Path) -> dict[str, Path]:
    return {place.parent.name: place.parent for place in folder.glob(f"*/{ACCOUNT}")}
