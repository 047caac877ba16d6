"""Whether the clock of a stream keeps pace with the clock of this computer."""

from __future__ import annotations

import time

import numpy as np

_WINDOW_S = 5.0
_MOST = 0.1  # of a window; whoever states a wrong rate or unit is farther off


class Pace:
    """The best of what arrives in a window tells: late lines are late once only."""

    def __init__(self) -> None:
        self._begin_s = time.monotonic()
        self._ahead_s, self._ahead_before_s = -np.inf, np.nan
        self._drifts_s: list[float] = []

    def look(self, device_s: float) -> float | None:
        """Take the newest stamp; the clock's rate where it is off twice in a row."""
        now_s = time.monotonic()
        self._ahead_s = max(self._ahead_s, device_s - now_s)
        passed_s = now_s - self._begin_s
        if passed_s < _WINDOW_S:
            return None
        self._drifts_s.append((self._ahead_s - self._ahead_before_s) / passed_s)
        self._begin_s, self._ahead_before_s = now_s, self._ahead_s
        self._ahead_s = -np.inf
        newest = np.array(self._drifts_s[-2:])
        if len(newest) < 2 or not (np.all(newest > _MOST) or np.all(newest < -_MOST)):
            return None
        return float(1.0 + newest.mean())
