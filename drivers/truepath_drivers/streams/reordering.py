"""Records of a link that does not keep their order, as UDP."""

from __future__ import annotations

import heapq
from typing import Generic, TypeVar

from truepath_drivers import host_clock

Record = TypeVar("Record")


class Reordering(Generic[Record]):
    """Records in the order of their numbers, each held while one before it is missing.

    most : that are held; 0 gives each on as it comes
    longest_s : that one is held
    """

    def __init__(self, most: int, longest_s: float) -> None:
        self._most, self._longest_s = most, longest_s
        self._held: list[tuple[int, float, int, float, Record]] = []
        self._added = 0

    def add(self, number: int, time_s: float, record: Record) -> None:
        """Hold a record that has just arrived. time_s : by the device's clock"""
        now_s = host_clock.now_s()
        heapq.heappush(self._held, (number, time_s, self._added, now_s, record))
        self._added += 1

    def pop(self, last: int, *, more_waits: bool = False) -> Record | None:
        """The next record if it is due: it follows `last`, too many are held, or it was
        held too long.

        last : number of the record given on before; below 0 if there is none
        more_waits : further records have arrived and are added next: the time that one
            was held does not count yet
        """
        if not self._held:
            return None
        number, _, _, arrived_s, _ = self._held[0]
        is_next = last < 0 or number <= last + 1 or len(self._held) > self._most
        since_s = host_clock.now_s() - self._longest_s
        if is_next or (not more_waits and arrived_s <= since_s):
            return heapq.heappop(self._held)[-1]
        return None
