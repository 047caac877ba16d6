"""The SQLite file of a Run: opening it to write, inserting, sealing it for good."""

from __future__ import annotations

import contextlib
import hashlib
import sqlite3
from collections.abc import Iterator
from pathlib import Path

from app.files.whole_files import sync_to_disk
from app.measurement.run_file import Batch


def connect(file: Path) -> sqlite3.Connection:
    """Open a Run file to write, every commit synced to the disk."""
    database = sqlite3.connect(file, isolation_level=None, check_same_thread=False)
    try:
        database.execute("PRAGMA busy_timeout = 5000")
        database.execute("PRAGMA journal_mode = WAL")
        database.execute("PRAGMA synchronous = FULL")
    except sqlite3.Error:
        database.close()
        raise
    return database


@contextlib.contextmanager
def transaction(database: sqlite3.Connection) -> Iterator[None]:
    """All of the block's statements, or none."""
    database.execute("BEGIN IMMEDIATE")
    try:
        yield
        database.execute("COMMIT")
    except BaseException:
        with contextlib.suppress(sqlite3.Error):
            database.execute("ROLLBACK")
        raise


def insert_manifest(database: sqlite3.Connection, manifest: dict[str, str]) -> None:
    """Insert rows into the table `manifest`, in one transaction."""
    with transaction(database):
        put_manifest(database, manifest)


def put_manifest(database: sqlite3.Connection, manifest: dict[str, str]) -> None:
    """Insert rows into the table `manifest`, or replace them."""
    database.executemany(
        "INSERT OR REPLACE INTO manifest VALUES (?, ?)", manifest.items()
    )


def insert_batches(database: sqlite3.Connection, batches: tuple[Batch, ...]) -> None:
    """Insert rows into the table `batch`."""
    database.executemany(
        "INSERT INTO batch VALUES (?, ?, ?, ?, ?, ?, ?)",
        [
            (b.stream, b.seq0, b.n, b.mono_ns, b.wall_ns, b.crc32, b.payload)
            for b in batches
        ],
    )


def seal(database: sqlite3.Connection, file: Path) -> str:
    """Close a Run file for good, one read-only file; return its SHA-256.

    Raises sqlite3.OperationalError if somebody else has the file open.
    """
    with contextlib.closing(database):
        busy, _, _ = database.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()
        if busy:
            raise sqlite3.OperationalError("the Run file is open elsewhere")
        database.execute("PRAGMA journal_mode = DELETE")
    file.chmod(0o444)
    sync_to_disk(file.parent)
    return hash_file(file)


def hash_file(file: Path) -> str:
    """Return the SHA-256 of a file."""
    with file.open("rb") as source:
        return hashlib.file_digest(source, "sha256").hexdigest()
