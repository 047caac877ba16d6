"""The line at whose end a motion ends, and whether the machine has left it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truepath.drivers.interfaces.records import MotionState, MotionStatus

OVERSHOT = 1.0
"""mm or deg; no servo goes so far beyond the end of a path."""


@dataclass(frozen=True, slots=True)
class LastLine:
    """The line at whose end a motion ends.

    number : of its row, as the controller counts
    begin, end : positions of the axes, or corners of what they stay within on an arc
    """

    number: int
    begin: NDArray[np.float64]
    end: NDArray[np.float64]

    def is_before(self, status: MotionStatus) -> bool:
        """Whether the machine runs on an earlier line, or it is the only one."""
        return self.number == 0 or (
            status.state is MotionState.RUNNING and status.line < self.number
        )

    def is_left(self, status: MotionStatus) -> bool:
        """Whether the machine runs on it, or says so, and is somewhere else."""
        if status.state is not MotionState.RUNNING or status.line < self.number:
            return False
        low, high = np.sort([self.begin, self.end], axis=0)
        here = np.array(status.position)
        return bool(((here < low - OVERSHOT) | (here > high + OVERSHOT)).any())
