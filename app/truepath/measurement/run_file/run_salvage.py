"""All readable rows of a Run file, and a list of the unreadable ones.

A file whose writer was killed is read in a copy, so that it stays as it is.
"""

from __future__ import annotations

import json
import shutil
import sqlite3
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from truepath.errors import BundleError
from truepath.files.bundle.run import RunEvent
from truepath.measurement.run_file.run_file import Batch

_LEAST_ROW_BYTES = 64  # no row of the file is smaller
_NO_RUN = ("no such table", "not a database")

Row = tuple[Any, ...]


@dataclass(frozen=True, slots=True)
class RunContent:
    """Readable rows of a Run file; `problems` describe the rest."""

    manifest: dict[str, str]
    batches: list[Batch]
    events: list[RunEvent]
    event_rows: list[Row]
    problems: list[str]


def read_content(file: Path) -> RunContent:
    """Readable part of a Run file. Raises BundleError if it is none."""
    if not file.is_file():
        raise BundleError("no such Run", file=str(file), remedy="check the path")
    try:
        with open_database(file) as database:
            return _read_rows(database, file)
    except sqlite3.Error as error:
        raise BundleError(
            f"is not a Run file ({error})", file=file.name, remedy="use a copy"
        ) from error


@contextmanager
def open_database(file: Path) -> Iterator[sqlite3.Connection]:
    """Open a Run to read. One with a log left behind is recovered in a copy of both."""
    log = find_log(file)
    if not log.exists():
        address = f"{file.absolute().as_uri()}?mode=ro&immutable=1"
        with closing(sqlite3.connect(address, uri=True)) as database:
            yield database
        return
    with tempfile.TemporaryDirectory(prefix="truepath-run-") as folder:
        copy = Path(folder) / file.name
        shutil.copyfile(file, copy)
        shutil.copyfile(log, copy.with_name(log.name))
        with closing(sqlite3.connect(copy)) as database:
            yield database


def find_log(file: Path) -> Path:
    """SQLite's write-ahead log of the file."""
    return file.with_name(file.name + "-wal")


def _read_rows(database: sqlite3.Connection, file: Path) -> RunContent:
    problems: list[str] = []
    manifest = _read_table(database, "manifest", "key, value", file, problems)
    columns = "stream, seq0, n, mono_ns, wall_ns, payload, crc32"
    batches: list[Batch] = []
    for *row, crc32 in _read_table(database, "batch", columns, file, problems):
        batch = Batch(*row)
        if _is_complete(batch, crc32):
            batches.append(batch)
        else:
            problems.append(f"batch of {row[0]} at {row[1]}: its CRC does not match")
    batches.sort(key=lambda b: (b.stream, b.seq0))
    event_rows = _read_table(
        database, "event", "seq, mono_ns, wall_ns, kind, body", file, problems
    )
    events = [_event(row, problems) for row in event_rows]
    return RunContent(
        dict(manifest), batches, [e for e in events if e], event_rows, problems
    )


def _is_complete(batch: Batch, crc32: int) -> bool:
    try:
        return batch.crc32 == crc32
    except (TypeError, AttributeError, ArithmeticError, ValueError):
        return False  # a damaged page may hold any type in any column


def _event(row: Row, problems: list[str]) -> RunEvent | None:
    seq, mono_ns, _, kind, body = row
    try:
        return RunEvent(int(mono_ns), str(kind), str(json.loads(body)["text"]))
    except (TypeError, ValueError, KeyError):
        problems.append(f"event {seq} is damaged")
        return None


def _read_table(
    database: sqlite3.Connection,
    table: str,
    columns: str,
    file: Path,
    problems: list[str],
) -> list[Row]:
    """Row by row where a page is damaged."""
    query = f"SELECT {columns} FROM {table}"  # noqa: S608
    try:
        return database.execute(f"{query} ORDER BY rowid").fetchall()
    except sqlite3.DatabaseError as error:
        if any(sign in str(error) for sign in _NO_RUN):
            raise
    problems.append(f"pages of the table {table} are damaged")
    rows: list[Row] = []
    for number in range(1, file.stat().st_size // _LEAST_ROW_BYTES):
        try:
            rows += database.execute(f"{query} WHERE rowid = ?", (number,)).fetchall()
        except sqlite3.DatabaseError:
            continue
    return rows
