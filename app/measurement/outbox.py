"""Sends the events of a cell process to its parent, which may be slow."""

from __future__ import annotations

import threading
from collections import deque
from multiprocessing.connection import Connection

from truepath.app.measurement.messages import (
    BlockRecorded,
    CellEvent,
    LivePoints,
    MeasurementProgress,
)

_LATEST_ONLY = (LivePoints, MeasurementProgress)
MAX_BLOCKS = 100


class Outbox:
    """A thread that sends, so that nobody else ever waits for the parent.

    While the parent is slow, only the latest LivePoints and MeasurementProgress wait
    and about ten seconds of blocks. Every other event is kept, in order, however many:
    a state or a fault is never dropped.
    """

    def __init__(self, link: Connection) -> None:
        self._link = link
        self._waiting: deque[CellEvent] = deque()
        self._changed = threading.Condition()
        self._closing = False
        self.dropped_blocks = 0
        self._thread = threading.Thread(target=self._send, name="outbox", daemon=True)
        self._thread.start()

    def report(self, event: CellEvent) -> None:
        """Send an event as soon as the parent takes it. Any thread; never waits."""
        with self._changed:
            blocks = sum(isinstance(e, BlockRecorded) for e in self._waiting)
            if isinstance(event, BlockRecorded) and blocks >= MAX_BLOCKS:
                self.dropped_blocks += 1
                return
            if isinstance(event, _LATEST_ONLY):
                kind = type(event)
                self._waiting = deque(e for e in self._waiting if type(e) is not kind)
            self._waiting.append(event)
            self._changed.notify()

    def close(self, timeout_s: float) -> None:
        """Send what waits, then end."""
        with self._changed:
            self._closing = True
            self._changed.notify()
        self._thread.join(timeout_s)

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
