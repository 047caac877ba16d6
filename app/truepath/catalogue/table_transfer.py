"""The tables of a catalogue as lines of JSON, and back: the same for either database.

Tables are exported as they are found, so that the catalogue of an earlier version is
exported by this one and put back by a later one. JSON columns are copied as text, not
parsed and encoded again.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from itertools import islice
from typing import Any

import sqlalchemy as sa

from truepath.catalogue.database import Database
from truepath.errors import BadInput

_REVISIONS = "alembic_version"
_MANY = 500

Row = Mapping[str, Any]


class CatalogueExport:
    """One consistent view of all tables, while others continue to write.

    revision : of the schema; tables : names, in an order in which rows can be put back
    """

    def __init__(self, connection: sa.Connection, revision: str) -> None:
        self._connection, self.revision = connection, revision
        self._tables = _reflect_tables(connection)
        self.tables = [table.name for table in self._tables]

    def read(self, name: str) -> Iterator[bytes]:
        """Rows of a table, one line of JSON each."""
        (table,) = [one for one in self._tables if one.name == name]
        columns = [_as_plain(column) for column in table.columns]
        order = list(table.primary_key.columns)
        query = sa.select(*columns).order_by(*order)
        rows = self._connection.execute(query.execution_options(yield_per=_MANY))
        for row in rows.mappings():
            yield json.dumps(dict(row), ensure_ascii=False).encode() + b"\n"


@contextmanager
def open_export(database: Database) -> Iterator[CatalogueExport]:
    """Open a view of a catalogue. Raises BadInput where there is none yet."""
    revision = database.check()
    if revision is None:
        raise BadInput("there is no catalogue yet, so there is nothing to keep")
    with database.read_snapshot() as connection:
        yield CatalogueExport(connection, revision)


def import_tables(
    database: Database, revision: str, tables: Mapping[str, Iterable[bytes]]
) -> None:
    """Make an empty catalogue that of an export, and bring it up to this version.

    tables : lines by table, in the order of the export

    Raises BadInput where the catalogue is not empty, SchemaTooNew, SchemaTooOld, and
    ValueError where a line is not a row.
    """
    if database.check() is not None:
        raise BadInput(
            "the catalogue is not empty; give the address of an empty database"
        )
    database.migrate(revision)

    def change(connection: sa.Connection) -> None:
        known = {table.name: table for table in _reflect_tables(connection)}
        for name, lines in tables.items():
            _insert_rows(connection, known[name], lines)
        _set_sequences(connection, known.values())

    database.write(change)
    database.migrate()


def _reflect_tables(connection: sa.Connection) -> list[sa.Table]:
    found = sa.MetaData()
    found.reflect(connection)
    return [table for table in found.sorted_tables if table.name != _REVISIONS]


def _as_plain(column: sa.Column[Any]) -> sa.ColumnElement[Any]:
    if isinstance(column.type, sa.JSON):
        return sa.cast(column, sa.Text).label(column.name)
    return column


def _insert_rows(
    connection: sa.Connection, table: sa.Table, lines: Iterable[bytes]
) -> None:
    """Values have no type here, so the driver passes them on unchanged."""
    connection.execute(sa.delete(table))  # what a migration has put there
    plain = sa.table(table.name, *(sa.column(c.name) for c in table.columns))
    rows = (json.loads(line) for line in lines)
    while chunk := list(islice(rows, _MANY)):
        connection.execute(sa.insert(plain), chunk)


def _set_sequences(connection: sa.Connection, tables: Iterable[sa.Table]) -> None:
    """Let PostgreSQL count on from the rows; SQLite does so automatically."""
    if connection.dialect.name != "postgresql":
        return
    for table in tables:
        for column in table.primary_key.columns:
            if isinstance(column.type, sa.Integer):
                sequence = sa.func.pg_get_serial_sequence(table.name, column.name)
                newest = sa.select(sa.func.max(column)).scalar_subquery()
                connection.execute(sa.select(sa.func.setval(sequence, newest)))
