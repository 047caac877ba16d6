"""Whether the file of a catalogue can be used; checks, and changes nothing."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

from truepath.catalogue.errors import (
    CatalogueDamaged,
    CatalogueReadOnly,
    StorageUnavailable,
)
from truepath.catalogue.schema import metadata

_MAGIC = b"SQLite format 3\0"
_REVISION = "alembic_version"


def check_catalogue(file: Path, newest: str, *, patience_s: float = 5.0) -> None:
    """Check that a catalogue is intact, or that there is none yet.

    newest : the schema whose tables are known
    patience_s : how long another program may hold it

    Raises CatalogueDamaged, CatalogueReadOnly, and StorageUnavailable while another
    program holds it.
    """
    if not file.exists() and not file.is_symlink():
        return
    _check_place(file)
    try:
        with closing(_open_to_read(file, patience_s)) as database:
            _check_pages(file, database)
            _check_tables(file, database, newest)
    except sqlite3.DatabaseError as error:
        if "locked" in str(error) or "busy" in str(error):
            raise StorageUnavailable(f"the catalogue is in use: {error}") from error
        raise CatalogueDamaged(file, f"is damaged ({error})") from error


def _check_place(file: Path) -> None:
    if not file.is_file():
        what = "a folder" if file.is_dir() else "no file"
        raise CatalogueDamaged(file, f"is {what} where the catalogue should be")
    try:
        with file.open("r+b") as source:
            head = source.read(len(_MAGIC))
    except OSError as error:
        raise CatalogueReadOnly(
            f"{file}: cannot be written ({error.strerror}), so the service cannot keep "
            "its jobs; give its account the right to read and write the file"
        ) from error
    if head != _MAGIC:
        what = "is not a SQLite file" if head else "is empty"
        raise CatalogueDamaged(file, what)


def _open_to_read(file: Path, patience_s: float) -> sqlite3.Connection:
    address = f"{file.absolute().as_uri()}?mode=ro"
    return sqlite3.connect(address, uri=True, timeout=patience_s)


def _check_pages(file: Path, database: sqlite3.Connection) -> None:
    (found,) = database.execute("PRAGMA quick_check(1)").fetchone()
    if found != "ok":
        raise CatalogueDamaged(file, f"is damaged ({' '.join(found.split())})")


def _check_tables(file: Path, database: sqlite3.Connection, newest: str) -> None:
    query = "SELECT name FROM sqlite_master WHERE type = 'table'"
    tables = {name for (name,) in database.execute(query)}
    if not tables:
        return  # killed before the first schema existed
    if _REVISION not in tables:
        raise CatalogueDamaged(file, "is a SQLite file of something else")
    revision = database.execute(f"SELECT version_num FROM {_REVISION}").fetchall()  # noqa: S608
    if revision != [(newest,)]:
        return
    for table in metadata.sorted_tables:
        there = {row[1] for row in database.execute(f"PRAGMA table_info({table.name})")}
        missing = sorted({column.name for column in table.columns} - there)
        if missing:
            what = f"has no {table.name}.{missing[0]} although it is of schema {newest}"
            raise CatalogueDamaged(file, what)
