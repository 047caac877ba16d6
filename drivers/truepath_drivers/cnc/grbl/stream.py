"""The count of what GRBL holds unread: never more than fits, never a line twice."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator

from truepath_drivers import host_clock
from truepath_drivers.cnc.grbl.program import Block


class Stream:
    """Lines on their way. GRBL answers each once it has read it, in order.

    rows : that are done
    """

    def __init__(self, blocks: Iterable[Block] = (), buffer_bytes: int = 0) -> None:
        self._blocks: Iterator[Block] = iter(blocks)
        self._next = next(self._blocks, None)
        self._free = buffer_bytes
        self._under_way: deque[Block] = deque()
        self._changed_s = host_clock.now_s()
        self.rows = 0

    @property
    def is_done(self) -> bool:
        """Whether every line was sent and answered."""
        return self._next is None and not self._under_way

    @property
    def is_sent(self) -> bool:
        """Whether every line was sent."""
        return self._next is None

    def take(self) -> bytes:
        """Return the lines that fit now; they are on their way."""
        taken = b""
        while self._next is not None and len(self._next.text) <= self._free:
            self._free -= len(self._next.text)
            taken += self._next.text
            self._under_way.append(self._next)
            self._next = next(self._blocks, None)
        if taken:
            self._changed_s = host_clock.now_s()
        return taken

    def answer(self) -> Block | None:
        """Take a reply; return its line, None where none waits for one."""
        if not self._under_way:
            return None
        block = self._under_way.popleft()
        self._free += len(block.text)
        self.rows += block.ends_row
        self._changed_s = host_clock.now_s()
        return block

    def measure_silence_s(self) -> float:
        """Return how much longer than it may a reply has stayed away."""
        if not self._under_way:
            return 0.0
        return host_clock.now_s() - self._changed_s - self._under_way[0].wait_s

    def touch(self) -> None:
        """Begin the patience anew: it moves, or is held."""
        self._changed_s = host_clock.now_s()
