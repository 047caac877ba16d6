"""The audit log: rows that are only ever added, each chained to the one before.

hash of a row = SHA-256 of the hash before and of the row as JSON with sorted keys
"""

from __future__ import annotations

import hashlib
import json
import threading
from collections import deque
from collections.abc import Iterator, Mapping
from concurrent.futures import Future
from dataclasses import asdict, dataclass, replace
from typing import Any

import structlog
from sqlalchemy import Connection, Row, insert, select, update

from truepath.catalogue.database import Database
from truepath.catalogue.errors import StorageUnavailable
from truepath.catalogue.job import format_utc_now
from truepath.catalogue.schema import audit, audit_head
from truepath.log_throttle import LogThrottle
from truepath_drivers import host_clock

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
        return self._database.write(
            lambda connection: self.append_within(connection, entry)
        )

    def append_within(self, connection: Connection, entry: Entry) -> AuditRow:
        """Add an entry within the transaction that it describes."""
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


log = structlog.get_logger(__name__)

REPEATS_S = 10.0
MOST_WAITING = 5_000
"""Entries beyond are not in the audit log; the log of the service says how many."""
MOST_KINDS = 200
"""Repeats of more kinds at one time are counted together, by outcome."""
_PAUSE_S = 1.0
_CLOSE_S = 5.0


@dataclass(slots=True)
class _Repeats:
    newest: Entry
    due_s: float
    count: int = 0


class AuditWriter:
    """Adds entries in the order in which they come."""

    def __init__(self, audit_log: AuditLog) -> None:
        self._audit_log, self._throttle = audit_log, LogThrottle()
        self._changed = threading.Condition()
        self._waiting: deque[tuple[Entry, Future[None]]] = deque()
        self._repeats: dict[tuple[str, ...], _Repeats] = {}
        self._closing = threading.Event()
        self._lost = 0
        self._thread = threading.Thread(
            target=self._write_all, name="audit-writer", daemon=True
        )
        self._thread.start()

    def record(self, entry: Entry, *, may_repeat: bool = False) -> Future[None]:
        """Queue an entry; the future is done once it is committed.

        may_repeat : count it where the same was recorded shortly before
        """
        stamped = replace(entry, at=entry.at or format_utc_now())
        done: Future[None] = Future()
        done.set_running_or_notify_cancel()  # no waiting caller can cancel it
        with self._changed:
            if may_repeat and self._count_repeat(stamped):
                done.set_result(None)
            else:
                self._add(stamped, done)
        return done

    def close(self) -> None:
        """Write the waiting entries, then end; log how many could not be written."""
        with self._changed:
            self._closing.set()
            self._add_repeats(float("inf"))
            self._changed.notify()
        host_clock.join(self._thread, _CLOSE_S)
        with self._changed:
            lost = self._lost + len(self._waiting)
        if lost:
            log.error("the audit log is not complete", not_written=lost)

    def _count_repeat(self, entry: Entry) -> bool:
        key = entry.who, entry.source, entry.what, entry.outcome, str(entry.new)
        if key not in self._repeats and len(self._repeats) >= MOST_KINDS:
            many = Entry("", "", "", "", "requests of many kinds", entry.outcome)
            key, entry = ("", entry.outcome), replace(many, at=entry.at)
        known = self._repeats.get(key)
        if known is None:
            due_s = host_clock.now_s() + REPEATS_S
            self._repeats[key] = _Repeats(entry, due_s)
            return False
        known.newest, known.count = entry, known.count + 1
        return True

    def _add(self, entry: Entry, done: Future[None]) -> None:
        if len(self._waiting) < MOST_WAITING:
            self._waiting.append((entry, done))
            self._changed.notify()
            return
        self._lost += 1
        done.set_result(None)
        if self._throttle.is_due():
            log.error("too much waits for the audit log", not_written=self._lost)

    def _add_repeats(self, now_s: float) -> None:
        for key, one in [*self._repeats.items()]:
            if one.due_s > now_s:
                continue
            if one.count == 0:
                del self._repeats[key]
                continue
            counted = {**(one.newest.new or {}), "times": one.count}
            self._add(replace(one.newest, new=counted), Future())
            one.due_s, one.count = now_s + REPEATS_S, 0

    def _write_all(self) -> None:
        while (item := self._wait_for_next()) is not None and self._write(item[0]):
            with self._changed:
                self._waiting.popleft()
            item[1].set_result(None)

    def _wait_for_next(self) -> tuple[Entry, Future[None]] | None:
        with self._changed:
            self._add_repeats(host_clock.now_s())
            while not self._waiting:
                if self._closing.is_set():
                    return None
                dues_s = [one.due_s for one in self._repeats.values()]
                now_s = host_clock.now_s()
                wait_s = min(dues_s) - now_s if dues_s else None
                host_clock.wait_for(
                    self._changed,
                    lambda: bool(self._waiting) or self._closing.is_set(),
                    None if wait_s is None else max(0.0, wait_s),
                )
                self._add_repeats(host_clock.now_s())
            return self._waiting[0]

    def _write(self, entry: Entry) -> bool:
        """Repeats while the catalogue is unavailable; False at the end."""
        while True:
            try:
                self._audit_log.append(entry)
            except StorageUnavailable as error:
                if self._throttle.is_due():
                    reason = str(error)
                    log.warning("the audit log waits", reason=reason, what=entry.what)
                if host_clock.wait(self._closing, _PAUSE_S):
                    return False
            except Exception:
                log.exception("not in the audit log", what=entry.what, who=entry.who)
                self._lost += 1
                return True
            else:
                return True
