"""Clocks of a simulated machine: of its motion, and of its time limits."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class MachineClock:
    """Machine seconds since an epoch: the host's monotonic clock, sped up.

    The same in every process of the host.
    """

    epoch_ns: int
    speed: float

    def now_s(self) -> float:
        """Machine seconds."""
        return (time.monotonic_ns() - self.epoch_ns) * 1e-9 * self.speed


class AwakeClock:
    """Wall seconds in which the process of a simulated device has run.

    A real device is never late, a simulated one may be suspended or starved with its
    host. While it did not run, no time limit of it ran either: a longer step between
    two readings counts as `late_s`.
    """

    def __init__(
        self, late_s: float, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._late_s, self._clock = late_s, clock
        self._read_s = self._now_s = clock()

    def __call__(self) -> float:
        """Seconds, counted at each call."""
        read_s = self._clock()
        self._now_s += min(read_s - self._read_s, self._late_s)
        self._read_s = read_s
        return self._now_s
