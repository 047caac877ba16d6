"""Writes the audit log in its own thread: no request waits for a locked file.

Requests that a client can repeat without limit, refusals and stops, are one row the
first time and then one row with a count per `REPEATS_S`.
"""

from __future__ import annotations

import threading
from collections import deque
from concurrent.futures import Future
from dataclasses import dataclass, replace

import structlog

from truepath.catalogue.errors import StorageUnavailable
from truepath.catalogue.job import format_utc_now
from truepath.log_throttle import LogThrottle
from truepath.users.audit import AuditLog, Entry
from truepath_drivers import host_clock

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
