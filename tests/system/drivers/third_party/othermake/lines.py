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

from dataclasses import dataclass

MAX_LINE = 200


def seal(text: str) -> bytes:
    """Return a line as it goes over the wire."""
    return f"{text}*{sum(text.encode()) & 0xFF:02X}\n".encode()


def check(line: bytes) -> str | None:
    """Return the text of a line, None if its sum does not match."""
    text, star, _ = line.rpartition(b"*")
    if not star or seal(text.decode("ascii", "replace")) != line + b"\n":
        return None
    return text.decode("ascii", "replace")


@dataclass(frozen=True, slots=True)
class Sample:
    """A sample in Truepath's terms: whole number, device seconds, right-handed."""

    number: int
    time_s: float
    position_mm: tuple[float, float, float]
    status: int


class Continuation:
    """Makes numbers and times whole that begin anew with every GO.

    lost : samples that the device took and that never came
    """

    def __init__(self) -> None:
        self.lost = 0
        self._first = self._next = 0  # of this stream; of the next sample
        self._clock_ms = 0.0

    def begin(self, clock_ms: float) -> None:
        """A stream begins."""
        self._first, self._clock_ms = self._next, clock_ms

    def end(self, count: int) -> None:
        """A stream has ended after so many samples: what is missing now is lost."""
        self._miss_until(self._first + count)

    def take(self, fields: list[str]) -> Sample:
        """Return the sample that a line tells. Raises ValueError if it is none."""
        n, ms, x, y, z, good = map(float, fields)
        number = self._first + int(n)
        if number < self._next:
            raise ValueError(f"sample {int(n)} came twice")
        self._miss_until(number)
        self._next = number + 1
        time_s = 1e-3 * (self._clock_ms + ms)
        return Sample(number, time_s, (x, -y, z), 0 if good == 1.0 else 1)

    def _miss_until(self, number: int) -> None:
        self.lost += max(number - self._next, 0)
        self._next = max(number, self._next)
