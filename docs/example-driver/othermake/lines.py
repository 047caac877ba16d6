"""The lines of an LT-50: `TEXT*SS` and a line feed, SS the sum of TEXT's bytes.

    host         device
    WHO          ME maker;model;serial number;firmware
    GO rate      GO rate clock        clock in ms when sample 0 is taken
    HALT         HALT count           samples taken since GO
                 S n ms x y z good    n from 0 and ms since GO; mm; good is 1 or 0
                 NO reason

The frame is left-handed: x forward, y right, z up.
"""

from __future__ import annotations

from collections import deque

from truepath_drivers.streams.numbering import SampleNumbers
from truepath_drivers.streams.received_bytes import ReceivedBytes

MAX_LINE = 200

Sample = tuple[int, float, tuple[float, float, float], int]
"""In Truepath's terms: whole number, device seconds, right-handed place, status."""


def seal(text: str) -> bytes:
    """Return a line as it goes over the wire."""
    return f"{text}*{sum(text.encode()) & 0xFF:02X}\n".encode()


def check(line: bytes) -> str | None:
    """Return the text of a line, None if its sum does not match."""
    text = line.rpartition(b"*")[0].decode("ascii", "replace")
    return text if seal(text) == line + b"\n" else None


class Inbox:
    """Samples and replies among the bytes that come.

    Numbers and times, which begin anew with every GO, are made to go on.
    """

    def __init__(self) -> None:
        self.samples: list[Sample] = []
        self.replies: deque[str] = deque()
        self.link_bytes = ReceivedBytes()
        self.bad_lines = 0
        self._rest = b""
        self._numbers, self._clock_ms = SampleNumbers(), 0.0

    def take(self, data: bytes) -> None:
        """Sort the next bytes."""
        self.link_bytes.add(data)
        *lines, rest = (self._rest + data).split(b"\n")
        self._rest = rest[-MAX_LINE:]
        for line in lines:
            text = check(line)
            self.bad_lines += text is None or not self._sort(text)

    def _sort(self, text: str) -> bool:
        kind, *fields = text.split(" ")
        try:
            if kind == "S":
                return self._take_sample(fields)
            if kind == "GO":
                self._clock_ms = float(fields[1])
                self._numbers.restart_counter()
        except (ValueError, IndexError):
            return False
        self.replies.append(text)
        return True

    def _take_sample(self, fields: list[str]) -> bool:
        n, ms, x, y, z, good = map(float, fields)
        number = self._numbers.from_counter(int(n))
        if not self._numbers.accept(number):
            return False  # it came twice
        time_s = 1e-3 * (self._clock_ms + ms)
        self.samples.append((number, time_s, (x, -y, z), 0 if good == 1.0 else 1))
        return True
