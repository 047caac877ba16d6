"""How much of a stream is damaged: bad frames, and samples lost here and there."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from truepath.drivers.interfaces.records import TrackerSamples

_WINDOW_S = 1.0


@dataclass(frozen=True, slots=True)
class _Look:
    """What one block has shown: samples lost before or in it, in how many gaps."""

    device_time_s: float
    lost: int
    gaps: int
    crc_errors: int


class StreamDamage:
    """Counts what is bad or lost in the last second of the tracker's clock.

    One gap alone is a silence, however long, and not counted here.

    share : above it the stream is damaged
    """

    def __init__(self, rate_hz: float, share: float) -> None:
        self._limit = max(share * rate_hz * _WINDOW_S, 1.0)
        self._looks: deque[_Look] = deque()
        self._sequence: int | None = None
        self._crc_errors: int | None = None

    def note(self, samples: TrackerSamples, crc_errors: int) -> None:
        """Take note of a block that is not empty, and of all CRC errors so far."""
        first = int(samples.sequence[0])
        before = first - 1 if self._sequence is None else self._sequence
        missing = np.diff(samples.sequence, prepend=before) - 1
        bad = 0 if self._crc_errors is None else crc_errors - self._crc_errors
        self._sequence, self._crc_errors = int(samples.sequence[-1]), crc_errors
        now_s = float(samples.device_time_s[-1])
        lost, gaps = int(missing.sum()), int((missing > 0).sum())
        self._looks.append(_Look(now_s, lost, gaps, bad))
        while self._looks[0].device_time_s <= now_s - _WINDOW_S:
            self._looks.popleft()

    @property
    def is_over_limit(self) -> bool:
        """Whether more than the allowed share of a second is bad or lost."""
        lost = sum(look.lost for look in self._looks)
        gaps = sum(look.gaps for look in self._looks)
        bad = sum(look.crc_errors for look in self._looks)
        return max(lost if gaps > 1 else 0, bad) > self._limit
