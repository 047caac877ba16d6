"""The time that this process has run, for patience with those it listens to."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable


class RunningClock:
    """A clock that all but stands while nobody reads it. For any thread.

    Read many times a second, it keeps up with the clock behind it. Of a longer step,
    in which the process was suspended or starved, it counts `late_s` only.
    """

    def __init__(
        self, late_s: float, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._late_s, self._clock = late_s, clock
        self._lock = threading.Lock()
        self._read_s = self._now_s = clock()

    def __call__(self) -> float:
        """Return seconds."""
        with self._lock:
            read_s = self._clock()
            self._now_s += min(read_s - self._read_s, self._late_s)
            self._read_s = read_s
            return self._now_s
