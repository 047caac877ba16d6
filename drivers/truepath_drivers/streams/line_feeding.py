"""Lines sent to a device as its receive buffer has room, by counting characters.

The device answers each line once, in their order; until then its characters count as
unread. So the buffer never overflows and the device never waits for a line.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Generic, TypeVar


@dataclass(frozen=True, slots=True)
class Line:
    """A line with its end. is_barrier : nothing is sent behind it before its answer"""

    text: bytes
    is_barrier: bool = False


L = TypeVar("L", bound=Line)


class LineFeed(Generic[L]):
    """Lines and their answers.

    lines : read as they are sent; each shorter than the buffer
    buffer_bytes : of the device
    unanswered : sent lines, the oldest first
    """

    def __init__(self, lines: Iterable[L], buffer_bytes: int) -> None:
        self._lines: Iterator[L] = iter(lines)
        self._next = next(self._lines, None)
        self._free = buffer_bytes
        self.unanswered: deque[L] = deque()

    @property
    def is_sent(self) -> bool:
        """Whether every line was taken."""
        return self._next is None

    @property
    def is_done(self) -> bool:
        """Whether every line was taken and answered."""
        return self.is_sent and not self.unanswered

    def take(self) -> list[L]:
        """The lines that fit by now, to be sent at once, each a single time."""
        taken: list[L] = []
        while (line := self._next) and len(line.text) <= self._free:
            if self.unanswered and self.unanswered[-1].is_barrier:
                break
            self.unanswered.append(line)
            taken.append(line)
            self._free -= len(line.text)
            self._next = next(self._lines, None)
        return taken

    def answer(self) -> L | None:
        """The line that an answer belongs to; None where none was expected."""
        if not self.unanswered:
            return None
        line = self.unanswered.popleft()
        self._free += len(line.text)
        return line

    def discard_rest(self) -> None:
        """Send no more lines; answers to those sent are expected still."""
        self._lines, self._next = iter(()), None
