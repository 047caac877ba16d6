"""Writes the audit log in a thread of its own: no request waits for a locked file."""

from __future__ import annotations

import queue
import threading
from concurrent.futures import Future

import structlog

from truepath.app.jobs.errors import StorageUnavailable
from truepath.app.users.audit import AuditLog, Entry

log = structlog.get_logger(__name__)

_PAUSE_S = 1.0


class AuditWriter:
    """Adds entries in the order in which they come; none is dropped while it runs."""

    def __init__(self, audit_log: AuditLog) -> None:
        self._audit_log = audit_log
        self._waiting: queue.SimpleQueue[tuple[Entry, Future[None]] | None] = (
            queue.SimpleQueue()
        )
        self._closing = threading.Event()
        self._thread = threading.Thread(
            target=self._write_all, name="audit-writer", daemon=True
        )
        self._thread.start()

    def record(self, entry: Entry) -> Future[None]:
        """Take an entry on; done once it is committed."""
        done: Future[None] = Future()
        self._waiting.put((entry, done))
        return done

    def close(self) -> None:
        """Write what waits, then end."""
        self._closing.set()
        self._waiting.put(None)
        self._thread.join(timeout=5.0)

    def _write_all(self) -> None:
        while (item := self._waiting.get()) is not None:
            entry, done = item
            self._write(entry)
            done.set_result(None)

    def _write(self, entry: Entry) -> None:
        """Write one entry, however long the catalogue is away."""
        while True:
            try:
                self._audit_log.append(entry)
            except StorageUnavailable as error:
                log.warning("the audit log waits", reason=str(error), what=entry.what)
                if self._closing.wait(_PAUSE_S):
                    log.error("not in the audit log", what=entry.what, who=entry.who)
                    return
            else:
                return
