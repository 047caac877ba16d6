"""How long to wait before a broken link is opened again: longer each time, never alike.

Several hosts that lost one gateway would else all come back to it at the same moments.
"""

from __future__ import annotations

import random
from collections.abc import Callable

FIRST_S, LONGEST_S = 0.1, 1.0
_LEAST_SHARE = 0.5  # of the pause, drawn at random up to the whole


class BackOff:
    """Pauses of `FIRST_S`, then each some twice as long, up to `LONGEST_S`.

    draw : a number of 0 to 1
    """

    def __init__(self, draw: Callable[[], float] = random.random) -> None:
        self._draw = draw
        self._pause_s = self._due_s = 0.0

    def is_due(self, now_s: float) -> bool:
        """Tell whether the next attempt may be made."""
        return now_s >= self._due_s

    def wait(self, now_s: float) -> None:
        """Let a pause begin: an attempt is made now."""
        self._pause_s = min(2.0 * self._pause_s + FIRST_S, LONGEST_S)
        share = _LEAST_SHARE + (1.0 - _LEAST_SHARE) * self._draw()
        self._due_s = now_s + share * self._pause_s

    def reset(self) -> None:
        """Begin anew: the link is back."""
        self._pause_s = self._due_s = 0.0
