"""How far a measurement is and how long it will still take."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.planning.configurations import Configurations
from app.planning.paths import line_times_s
from drivers.interfaces.records import Path

_TRUST_S = 3.0


@dataclass(frozen=True, slots=True)
class Schedule:
    """Planned time of each row, line towards it and dwell included.

    unit : what is counted, `lines` or `points`
    """

    unit: str
    row_s: NDArray[np.float64]

    @property
    def total(self) -> int:
        """Number of lines or points."""
        return len(self.row_s) - (self.unit == "lines")

    def done(self, row: int, *, finished: bool = False) -> int:
        """Return how many are done while the machine moves towards a row."""
        if finished:
            return self.total
        return max(row - (self.unit == "lines"), 0)

    def remaining_s(self, row: int, active_s: float) -> float:
        """Extrapolate: the planned rest, at the pace kept so far."""
        planned_s = float(self.row_s[:row].sum())
        left_s = float(self.row_s[row:].sum())
        # Early on the pace is noise; later it knows overrides and speed-ups.
        if planned_s < _TRUST_S or active_s <= 0:
            return max(left_s - active_s + planned_s, 0.0)
        return left_s * active_s / planned_s


def schedule_of(commanded: Path | Configurations, feed_mm_min: float) -> Schedule:
    """Return the schedule of a path, or of points stepped through at a feed."""
    if isinstance(commanded, Path):
        return Schedule("lines", line_times_s(commanded))
    n = len(commanded)
    path = Path(
        commanded.axes, commanded.position, np.full(n, feed_mm_min), commanded.dwell_s
    )
    return Schedule("points", line_times_s(path))
