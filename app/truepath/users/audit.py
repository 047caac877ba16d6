"""The audit log: rows that are only ever added, each chained to the one before.

hash of a row = SHA-256 of the hash before and of the row as JSON with sorted keys
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from sqlalchemy import Connection, Row, insert, select, update

from truepath.catalogue.database import Database
from truepath.catalogue.job import format_utc_now
from truepath.catalogue.schema import audit, audit_head

FIRST = "0" * 64
_BLOCK = 500


@dataclass(frozen=True, slots=True)
class Entry:
    """An action or a refused request.

    who, role : of the actor; empty where unknown
    source : address of the computer, `via` the proxy that has passed it on, if any;
        `command line` for a command on the service's own
    what : the verb and its object, as `POST /api/v1/jobs/ID/arm`
    outcome : status of the answer
    old, new : what it changed, where that is known
    at : when; empty for now
    """

    who: str
    role: str
    source: str
    request_id: str
    what: str
    outcome: str
    old: Mapping[str, Any] | None = None
    new: Mapping[str, Any] | None = None
    at: str = ""


@dataclass(frozen=True, slots=True)
class AuditRow:
    """One entry in its place in the chain."""

    seq: int
    entry: Entry
    hash: str


class AuditLog:
    """The audit log of one catalogue; safe for threads and processes."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def append(self, entry: Entry) -> AuditRow:
        """Add an entry as the newest row."""
        return self._database.write(lambda connection: self.join(connection, entry))

    def join(self, connection: Connection, entry: Entry) -> AuditRow:
        """Add an entry within the transaction that it describes."""
        return _append(connection, entry)

    def read(self, *, after: int = 0, limit: int | None = None) -> Iterator[AuditRow]:
        """Rows in their order, from the one after `after`."""
        left = limit
        while left is None or left > 0:
            count = _BLOCK if left is None else min(left, _BLOCK)
            query = select(audit).where(audit.c.seq > after).order_by(audit.c.seq)
            with self._database.read() as connection:
                rows = connection.execute(query.limit(count)).all()
            for row in rows:
                yield _decode(row)
                after = row.seq
            if len(rows) < count:
                return
            left = None if left is None else left - count

    def read_newest(self, *, before: int | None = None, limit: int) -> list[AuditRow]:
        """The newest rows first, below `before` where that is given."""
        query = select(audit).order_by(audit.c.seq.desc()).limit(limit)
        if before is not None:
            query = query.where(audit.c.seq < before)
        with self._database.read() as connection:
            return [_decode(row) for row in connection.execute(query)]

    def read_head(self) -> tuple[int, str]:
        """Number and hash of the newest row, as they were stored with it."""
        with self._database.read() as connection:
            return _read_head(connection)

    def verify(self) -> list[str]:
        """Faults of the chain, each row by its number; empty if it is intact."""
        wrong: list[str] = []
        expected, before = 1, FIRST
        # The head first: a row that is added meanwhile is no fault.
        head, head_hash = self.read_head()
        for row in self.read():
            if row.seq != expected:
                wrong.append(_describe_gap(expected, row.seq - 1))
            elif row.hash != _hash(before, row.seq, row.entry):
                wrong.append(f"row {row.seq} has been changed")
            elif row.seq == head and row.hash != head_hash:
                wrong.append(f"row {row.seq} is not the one that was noted as newest")
            expected, before = row.seq + 1, row.hash
        if head >= expected:
            wrong.append(_describe_gap(expected, head))
        return wrong


def encode_row(row: AuditRow) -> dict[str, Any]:
    """A row in the form of an export."""
    return {"seq": row.seq, **asdict(row.entry), "hash": row.hash}


def _append(connection: Connection, entry: Entry) -> AuditRow:
    seq, before = _read_head(connection, to_write=True)
    stamped = Entry(**{**asdict(entry), "at": entry.at or format_utc_now()})
    row = AuditRow(seq + 1, stamped, _hash(before, seq + 1, stamped))
    connection.execute(insert(audit).values(**encode_row(row)))
    head = {"seq": row.seq, "hash": row.hash}
    if seq == 0:
        connection.execute(insert(audit_head).values(id=1, **head))
    else:
        connection.execute(update(audit_head).values(**head))
    return row


def _read_head(connection: Connection, *, to_write: bool = False) -> tuple[int, str]:
    query = select(audit_head.c.seq, audit_head.c.hash)
    row = connection.execute(query.with_for_update() if to_write else query).first()
    return (row.seq, row.hash) if row is not None else (0, FIRST)


def _decode(row: Row[Any]) -> AuditRow:
    columns = dict(row._mapping)  # noqa: SLF001 (public by the documentation)
    seq, digest = columns.pop("seq"), columns.pop("hash")
    return AuditRow(seq, Entry(**columns), digest)


def _hash(before: str, seq: int, entry: Entry) -> str:
    content = json.dumps({"seq": seq, **asdict(entry)}, sort_keys=True)
    return hashlib.sha256(f"{before}\n{content}".encode()).hexdigest()


def _describe_gap(first: int, last: int) -> str:
    return (
        f"row {first} is missing"
        if first == last
        else (f"rows {first} to {last} are missing")
    )
