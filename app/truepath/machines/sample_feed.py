"""Samples that a cell records, for listeners during the measurement.

A slow listener loses the oldest ones, and learns how many; the cell never waits.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable

from truepath_drivers.interfaces.records import TrackerSamples

CHUNK = 20
"""Samples that are handed over together: 40 ms of a typical stream."""
CHUNKS = 50
"""That wait for one listener, two seconds; the oldest are dropped."""


class SampleQueue:
    """Samples that wait for one listener; thread-safe.

    on_put : called after each put; returns at once
    dropped : samples so far that were not taken in time
    """

    def __init__(self, on_put: Callable[[], None]) -> None:
        self._on_put, self.dropped = on_put, 0
        self._lock = threading.Lock()
        self._waiting: deque[TrackerSamples] = deque()

    def put(self, chunk: TrackerSamples) -> None:
        """Drops the oldest chunk if the queue is full. Never waits."""
        with self._lock:
            if len(self._waiting) >= CHUNKS:
                self.dropped += len(self._waiting.popleft())
            self._waiting.append(chunk)
        self._on_put()

    def pop_oldest(self) -> tuple[TrackerSamples | None, int]:
        """The oldest chunk, None if there is none, and `dropped` before it."""
        with self._lock:
            chunk = self._waiting.popleft() if self._waiting else None
            return chunk, self.dropped


class SampleFeed:
    """Hands blocks to listeners, in the thread that publishes."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._queues: tuple[SampleQueue, ...] = ()

    def subscribe(self, on_put: Callable[[], None]) -> SampleQueue:
        """A queue that fills from now on."""
        queue = SampleQueue(on_put)
        with self._lock:
            self._queues += (queue,)
        return queue

    def unsubscribe(self, queue: SampleQueue) -> None:
        """Stop filling a queue."""
        with self._lock:
            self._queues = tuple(one for one in self._queues if one is not queue)

    def publish(self, block: TrackerSamples) -> None:
        """Hand a block to every listener, in chunks. Returns at once."""
        queues = self._queues
        for begin in range(0, len(block), CHUNK) if queues else ():
            chunk = block.select(slice(begin, begin + CHUNK))
            for queue in queues:
                queue.put(chunk)
