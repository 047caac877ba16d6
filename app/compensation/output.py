"""Files of a format and their account, written where they are asked for."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from truepath.app.errors import BadInput, BundleError
from truepath.app.files.file_model import as_object, encode_json, parse_json
from truepath.app.files.whole_files import read_whole, replace_file

SCHEMA = "compensation/1"
_PLAIN_NAME = re.compile(r"[A-Za-z0-9._-]+")


def find_stem(output: str | Path, suffix: str) -> str:
    """Return what the names of the files begin with.

    suffix : of the format

    Raises BadInput for a stem that controls cannot read: it stands in the files.
    """
    place = Path(output)
    has_suffix = place.name.endswith(suffix)
    stem = place.name.removesuffix(suffix) if has_suffix else place.stem
    if _PLAIN_NAME.fullmatch(stem) is None:
        raise BadInput(
            f"{output}: {stem!r} stands in the files that controls read; use letters "
            "A to Z, digits, dots, dashes and underscores"
        )
    return stem


def write_output(
    files: Mapping[str, str],
    account: Mapping[str, Any],
    output: str | Path,
    stem: str,
    *,
    source: str | Path,
) -> dict[str, Any]:
    """Write files and their account, `STEM.json`; a single file to `output` itself.

    source : what the files are made of, which is not written over

    Returns the account, `files` as paths, their digests by name.

    Raises BadInput where the files would replace the source, or the account a file that
    is none.
    """
    place = Path(output)
    beside = place.parent / f"{stem}.json"
    alone = len(files) == 1 and place.suffix != "" and place != beside
    targets = {
        place if alone else place.parent / file: text.encode("ascii")
        for file, text in files.items()
    }
    _keep_source(source, (*targets, beside))
    _require_account(beside)
    account = {
        **account,
        "files": [str(target) for target in targets],
        "files_sha256": {
            target.name: hashlib.sha256(data).hexdigest()
            for target, data in targets.items()
        },
    }
    text = encode_json(account, indent=1)  # before any file, for none without it
    place.parent.mkdir(parents=True, exist_ok=True)
    for target, data in targets.items():
        replace_file(target, data)
    replace_file(beside, text)
    return account


def _keep_source(source: str | Path, targets: tuple[Path, ...]) -> None:
    for target in targets:
        if target.exists() and target.samefile(source):
            raise BadInput(
                f"{target}: would be written over, and is what the files are made of; "
                "give the output another name"
            )


def _require_account(beside: Path) -> None:
    """Raise BadInput where a file that is no account has the name of the account."""
    if not beside.exists():
        return
    try:
        schema = as_object(parse_json(read_whole(beside), str(beside))).get("schema")
    except BundleError:
        schema = None
    if schema != SCHEMA:
        raise BadInput(
            f"{beside}: the account of the files would be written over it, and it is "
            "none; give the output another name"
        )
