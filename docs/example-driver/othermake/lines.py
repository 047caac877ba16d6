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

MAX_LINE = 200
KEPT_BYTES = 1 << 22

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
    lost : samples that the device took and that never came
    """

    def __init__(self) -> None:
        self.samples: list[Sample] = []
        self.replies: deque[str] = deque()
        self.link_bytes = bytearray()
        self.good_lines = self.bad_lines = self.bad_bytes = self.lost = 0
        self._rest = b""
        self._first = self._next = 0  # of this stream; of the next sample
        self._clock_ms = 0.0

    def take(self, data: bytes) -> None:
        """Sort the next bytes."""
        self.link_bytes += data
        del self.link_bytes[:-KEPT_BYTES]
        *lines, rest = (self._rest + data).split(b"\n")
        self._rest = rest[-MAX_LINE:]
        for line in lines:
            text = check(line)
            if text is None or not self._sort(text):
                self.bad_lines += 1
                self.bad_bytes += len(line)
            else:
                self.good_lines += 1

    def _sort(self, text: str) -> bool:
        kind, *fields = text.split(" ")
        try:
            if kind == "S":
                return self._take_sample(fields)
            if kind == "GO":
                self._first, self._clock_ms = self._next, float(fields[1])
            elif kind == "HALT":
                self._miss_until(self._first + int(fields[0]))
        except (ValueError, IndexError):
            return False
        self.replies.append(text)
        return True

    def _take_sample(self, fields: list[str]) -> bool:
        n, ms, x, y, z, good = map(float, fields)
        number = self._first + int(n)
        if number < self._next:
            return False  # it came twice
        self._miss_until(number)
        self._next = number + 1
        time_s = 1e-3 * (self._clock_ms + ms)
        self.samples.append((number, time_s, (x, -y, z), 0 if good == 1.0 else 1))
        return True

    def _miss_until(self, number: int) -> None:
        self.lost += max(number - self._next, 0)
        self._next = max(number, self._next)
