"""Waiting times after failed log-ins, and a limit on changes in a short time."""

from __future__ import annotations

import threading
from collections import OrderedDict
from dataclasses import dataclass

from truepath.users.errors import TooManyRequests, TooManyTries
from truepath_drivers import host_clock

LONGEST_WAIT_S = 900.0
FORGET_S = 3600.0
"""After so long without a failure earlier ones no longer count."""
_REMEMBERED = 10_000


@dataclass(frozen=True, slots=True)
class _Failures:
    count: int = 0
    last_s: float = 0.0
    until_s: float = 0.0


class BackOff:
    """Counts failures of each key, and makes a key wait longer after each further one.

    free : failures before the first wait of 1 s, which then doubles to the longest
    """

    def __init__(
        self,
        free: int,
        *,
        longest_s: float = LONGEST_WAIT_S,
    ) -> None:
        self._free, self._longest_s = free, longest_s
        self._lock = threading.Lock()
        self._failed: OrderedDict[str, _Failures] = OrderedDict()

    def check(self, key: str) -> None:
        """Raise TooManyTries while the key has to wait."""
        left_s = self.find_wait_s(key)
        if left_s > 0:
            raise TooManyTries(
                f"too many log-ins have failed; try again in {left_s:.0f} s", left_s
            )

    def find_wait_s(self, key: str) -> float:
        """Remaining wait of the key, s."""
        with self._lock:
            failures = self._failed.get(key, _Failures())
        return max(0.0, failures.until_s - host_clock.now_s())

    def fail(self, key: str) -> None:
        """Count a failure."""
        now_s = host_clock.now_s()
        with self._lock:
            before = self._failed.pop(key, _Failures())
            is_forgotten = now_s - before.last_s >= FORGET_S
            count = 1 if is_forgotten else before.count + 1
            over = count - self._free
            wait_s = min(2.0 ** min(over, 20), self._longest_s) if over >= 0 else 0.0
            self._failed[key] = _Failures(count, now_s, now_s + wait_s)
            if len(self._failed) > _REMEMBERED:
                self._failed.popitem(last=False)

    def clear(self, key: str) -> None:
        """Reset a key after a success."""
        with self._lock:
            self._failed.pop(key, None)


class RateLimit:
    """Limits requests per key: a burst, then a rate per second."""

    def __init__(
        self,
        burst: int,
        per_second: float,
    ) -> None:
        self._burst, self._per_second = burst, per_second
        self._lock = threading.Lock()
        self._left: OrderedDict[str, tuple[float, float]] = OrderedDict()

    def count_request(self, key: str) -> None:
        """Count one request. Raises TooManyRequests beyond the limit."""
        now = host_clock.now_s()
        with self._lock:
            left, since_s = self._left.pop(key, (float(self._burst), now))
            left = min(left + (now - since_s) * self._per_second, float(self._burst))
            self._left[key] = (left - 1.0 if left >= 1.0 else left), now
            if len(self._left) > _REMEMBERED:
                self._left.popitem(last=False)
        if left < 1.0:
            wait_s = (1.0 - left) / self._per_second
            raise TooManyRequests("too many requests in a short time", wait_s)
