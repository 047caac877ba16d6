"""Sends the events of a cell to its parent, who may be slow or gone."""

from __future__ import annotations

import threading
import time
from collections import deque
from multiprocessing.connection import Connection
from typing import Any

from app.measurement.orders import CellEvent

_LATEST_ONLY = frozenset({"live", "progress"})
MAX_WAITING = 1000
MAX_BLOCKS = 100


class Outbox:
    """A thread that sends, so that nobody else ever waits for the parent.

    Of `live` and `progress` only the latest waits while the parent is slow, of `block`
    about ten seconds; every other event is kept, in order.
    """

    def __init__(self, link: Connection) -> None:
        self._link = link
        self._waiting: deque[CellEvent] = deque(maxlen=MAX_WAITING)
        self._changed = threading.Condition()
        self._closing = False
        self.dropped_blocks = 0
        self._thread = threading.Thread(target=self._send, name="outbox", daemon=True)
        self._thread.start()

    def report(self, kind: str, body: dict[str, Any]) -> None:
        """Send an event as soon as the parent takes it. Any thread; never waits."""
        event = CellEvent(kind, body, time.monotonic_ns())
        with self._changed:
            if kind == "block" and self._blocks_waiting() >= MAX_BLOCKS:
                self.dropped_blocks += 1
                return
            if kind in _LATEST_ONLY:
                self._waiting = deque(
                    (e for e in self._waiting if e.kind != kind), maxlen=MAX_WAITING
                )
            self._waiting.append(event)
            self._changed.notify()

    def close(self, timeout_s: float) -> None:
        """Send what waits, then end."""
        with self._changed:
            self._closing = True
            self._changed.notify()
        self._thread.join(timeout_s)

    def _blocks_waiting(self) -> int:
        return sum(event.kind == "block" for event in self._waiting)

    def _send(self) -> None:
        """Body of the thread. Ends with the parent, too."""
        while (event := self._next()) is not None:
            try:
                self._link.send(event)
            except OSError:
                return

    def _next(self) -> CellEvent | None:
        with self._changed:
            while not self._waiting and not self._closing:
                self._changed.wait()
            return self._waiting.popleft() if self._waiting else None
