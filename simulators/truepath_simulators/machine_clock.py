"""The clocks of a simulated machine: of its motion, and of its patience."""

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
        """Return machine seconds."""
        return (time.monotonic_ns() - self.epoch_ns) * 1e-9 * self.speed


class AwakeClock:
    """Wall seconds in which the process of a simulated device has run.

    A device of iron is never late, one that is simulated may be suspended or starved
    with its host. While it did not run it was not waiting for anybody either: of a
    longer step between two readings `late_s` counts.
    """

    def __init__(
        self, late_s: float, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._late_s, self._clock = late_s, clock
        self._read_s = self._now_s = clock()

    def __call__(self) -> float:
        """Return seconds."""
        read_s = self._clock()
        self._now_s += min(read_s - self._read_s, self._late_s)
        self._read_s = read_s
        return self._now_s
