"""Rate limit for repeated log messages."""

from __future__ import annotations

import threading

from truepath_drivers import host_clock


class LogThrottle:
    """Limits the rate of a repeated message; any thread."""

    def __init__(self, every_s: float = 10.0) -> None:
        self._every_s, self._next_s = every_s, -float("inf")
        self._lock = threading.Lock()

    def is_due(self) -> bool:
        """True the first time, and then once in `every_s`."""
        now_s = host_clock.now_s()
        with self._lock:
            if now_s < self._next_s:
                return False
            self._next_s = now_s + self._every_s
            return True

    def reset(self) -> None:
        """Be due at the next call: the repeated event is over."""
        self._next_s = -float("inf")
