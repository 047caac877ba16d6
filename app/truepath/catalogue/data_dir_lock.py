"""The data folder, locked by one process at a time."""

from __future__ import annotations

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from truepath.catalogue.errors import InUse
from truepath.errors import BadInput

_AWAY = frozenset({"nfs", "nfs4", "cifs", "smb3", "smbfs", "9p", "fuse.sshfs", "afs"})
MOUNTS = Path("/proc/mounts")


@contextmanager
def hold_folder(folder: Path, mounts: Path = MOUNTS) -> Iterator[None]:
    """Make the data folder and lock it for this process. Raises BadInput, InUse."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = (folder / ".lock").open("w")
    except OSError as error:
        raise BadInput(f"setting data_dir: {folder}: {error.strerror}") from error
    with lock:
        kind = find_file_system(folder.resolve(), mounts)
        if kind is not None and is_network_share(kind):
            raise BadInput(
                f"setting data_dir: {folder} is on a share of the network ({kind}), "
                "where a Run can be damaged; give a disk of this computer"
            )
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise InUse(
                f"another instance works on {folder}; stop it, or give another data_dir"
            ) from error
        yield


def find_file_system(place: Path, mounts: Path = MOUNTS) -> str | None:
    """Kind of file system of an absolute path; None where unknown.

    mounts : as Linux lists them
    """
    try:
        rows = [line.split()[1:3] for line in mounts.read_text().splitlines()]
    except OSError:
        return None
    above = [row for row in rows if place.is_relative_to(row[0].replace("\\040", " "))]
    return max(above, key=lambda row: len(row[0]))[1] if above else None


def is_network_share(kind: str) -> bool:
    """Whether a kind of file system is on another computer.

    A Run is a SQLite file with a write-ahead log, which needs memory that several
    processes share: no network share has that.
    """
    return kind in _AWAY
