"""Lines put in order, of a link that may mix them up."""

from __future__ import annotations

import heapq
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from truepath_drivers import host_clock


class Line(NamedTuple):
    """One line, with its number and its time.

    arrival : how many came before it; arrived_s : on the host's clock
    """

    step: int
    time_s: float
    arrival: int
    arrived_s: float
    position_mm: NDArray[np.float64]
    status: int


class LineOrder:
    """Lines in the order of their numbers, each held while one before it is missing.

    most : that are held; 0 gives each line on as it comes
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._held: list[Line] = []
        self._added = 0

    def add(
        self, step: int, time_s: float, position_mm: NDArray[np.float64], status: int
    ) -> None:
        """Hold a line that has just arrived."""
        now_s = host_clock.now_s()
        line = Line(step, time_s, self._added, now_s, position_mm, status)
        self._added += 1
        heapq.heappush(self._held, line)

    def pop(self, next_step: float, since_s: float) -> Line | None:
        """The first line, if its number is due, if more than `most` are held, or if it
        is held since then.
        """
        if not self._held:
            return None
        first = self._held[0]
        is_full = len(self._held) > self._most
        if is_full or first.step <= next_step or first.arrived_s <= since_s:
            return heapq.heappop(self._held)
        return None
