"""Clocks of the engine: the time in which it ran, and how long a condition holds."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable


class RunningClock:
    """Counts the time in which this process ran. For any thread.

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


class Stopwatch:
    """Measures how long a condition has held, from the first look at it."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._begun_s: float | None = None

    def measure_s(self) -> float:
        """Return the seconds since the first call after `reset`."""
        now_s = self._clock()
        if self._begun_s is None:
            self._begun_s = now_s
        return now_s - self._begun_s

    def reset(self) -> None:
        """Begin again at the next look."""
        self._begun_s = None
