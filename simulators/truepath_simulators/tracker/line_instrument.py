"""An instrument with requests in lines of text and replies after a delay. No I/O."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

from truepath_simulators.compensation.correction import Correction
from truepath_simulators.machine.tracker_head import TrackerPose
from truepath_simulators.timeline import Timeline
from truepath_simulators.tracker.polled_head import PolledHead

Say = Callable[[Timeline, float], bytes]
"""Makes a reply at the machine's time at which it is due."""


class LineInstrument(ABC):
    """Splits bytes into lines, and sends each reply when it is due."""

    def __init__(self, head: PolledHead) -> None:
        self.head = head
        self._rest = b""
        self._lines: list[bytes] = []
        self._due: list[tuple[float, Say]] = []

    @property
    def streaming(self) -> bool:
        """Whether a reply or a line is pending."""
        return bool(self._due or self._lines)

    def read_state(self) -> dict[str, Any]:
        """Number of shots and of pending replies."""
        return {"streaming": False, "shots": self.head.shots, "replies": len(self._due)}

    def receive(self, data: bytes, true_s: float, wall_s: float) -> bytes:
        """Take bytes of the host; every reply comes by `due`."""
        del wall_s
        self.head.begin(true_s)
        *lines, self._rest = (self._rest + data).split(b"\r\n")
        self._lines += [line.strip() for line in lines if line.strip()]
        return b""

    def due(
        self, timeline: Timeline, true_s: float, wall_s: float, waiting_bytes: int = 0
    ) -> bytes:
        """Every reply due by now."""
        del wall_s, waiting_bytes
        for line in self._lines:
            self.answer(line, timeline, true_s)
        self._lines = []
        ready = [say for due_s, say in self._due if due_s <= true_s]
        self._due = [(due_s, say) for due_s, say in self._due if due_s > true_s]
        said = b"".join(say(timeline, true_s) for say in ready)
        return b"" if self.head.is_silent(true_s) else said

    def say(self, line: bytes, due_s: float = 0.0) -> None:
        """Send a line, at once or when it is due."""
        self.say_later(lambda *_: line, due_s)

    def say_later(self, make: Say, due_s: float) -> None:
        """Make a line when it is due, and send it."""
        self._due.append((due_s, lambda *at: make(*at) + b"\r\n"))

    def set_down(self, pose: TrackerPose) -> None:
        """Move the tracker to another pose from now on."""
        self.head.set_down(pose)

    def correct(self, correction: Correction | None) -> None:
        """Apply these tables to the machine from now on."""
        self.head.correct(correction)

    def forget_host(self) -> None:
        """Discard lines and replies: the connection has gone."""
        self._rest, self._lines, self._due = b"", [], []

    @abstractmethod
    def answer(self, line: bytes, timeline: Timeline, true_s: float) -> None:
        """Process a line of the host; replies by `say`."""
