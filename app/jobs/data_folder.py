"""The data folder, held by one process at a time."""

from __future__ import annotations

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from truepath.app.errors import BadInput
from truepath.app.jobs.errors import InUse


@contextmanager
def hold_folder(folder: Path) -> Iterator[None]:
    """Make the data folder and hold it for this process. Raises BadInput, InUse."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = (folder / ".lock").open("w")
    except OSError as error:
        raise BadInput(f"setting data_dir: {folder}: {error.strerror}") from error
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise InUse(
                f"another instance works on {folder}; stop it, or give another data_dir"
            ) from error
        yield
