"""Files that are read and written completely, or not at all."""

from __future__ import annotations

import os
import secrets
from collections.abc import Mapping
from pathlib import Path

from truepath.errors import BundleError

MAX_TEXT_BYTES = 64 << 20  # of a file that people write


def read_whole(file: str | Path, *, largest_bytes: int = MAX_TEXT_BYTES) -> bytes:
    """Raises BundleError where a file cannot be read, or is too large."""
    place = Path(file)
    try:
        if place.stat().st_size > largest_bytes:
            raise BundleError(
                f"is larger than {largest_bytes >> 20} MiB", file=str(file)
            )
        return place.read_bytes()
    except OSError as error:
        raise BundleError(
            f"cannot be read ({error.strerror})",
            file=str(file),
            remedy="check the path",
        ) from error


def replace_file(file: Path, data: bytes) -> None:
    """Write a file completely or not at all: a synced draft replaces it."""
    # Two threads may write the same file: each has its own draft.
    draft = file.with_name(f".{file.name}.{secrets.token_hex(6)}.tmp")
    try:
        with draft.open("wb") as sink:
            sink.write(data)
            sink.flush()
            os.fsync(sink.fileno())
        draft.replace(file)
    finally:
        draft.unlink(missing_ok=True)
    sync_to_disk(file.parent)


def write_files(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write files below a folder, in their order, each completely or not at all."""
    for name, data in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        replace_file(folder / name, data)


def sync_to_disk(place: Path) -> None:
    """Make a file, or a rename in a folder, survive a power cut."""
    handle = os.open(place, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
