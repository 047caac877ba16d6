"""A lock that lets a stop overtake an upload."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from truepath_drivers import host_clock


class PriorityLock:
    """Mutual exclusion in which urgent takers come before all others. Not reentrant.

    A plain lock is taken again by a busy thread before those that wait for it wake up:
    an abort could wait for the end of an upload.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._taken = False
        self._urgent = 0

    @property
    def is_wanted(self) -> bool:
        """Whether an urgent taker waits for it."""
        return self._urgent > 0

    @contextmanager
    def hold(self, *, urgent: bool = False) -> Iterator[None]:
        """Hold the lock inside a `with`."""
        self._take(urgent)
        try:
            yield
        finally:
            with self._changed:
                self._taken = False
                self._changed.notify_all()

    def _take(self, urgent: bool) -> None:
        with self._changed:
            self._urgent += urgent
            try:
                host_clock.wait_for(
                    self._changed,
                    lambda: not self._taken and (urgent or not self._urgent),
                )
            finally:
                self._urgent -= urgent
            self._taken = True
