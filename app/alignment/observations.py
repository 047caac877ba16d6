"""What alignment hands to estimation: one row a cell, no samples any more."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int64

from app.kinematics.conditions import Conditions
from app.numerics.rigid import RigidTransform


@dataclass(frozen=True, slots=True)
class Pass:
    """One uninterrupted stretch at constant feed along one line of the path.

    row : row of the path that the machine moved towards
    first, last : indices of its samples in the Run
    speed_mm_s : as measured; the mean along the line where it is a curve
    share : of the line that was done at the middle of its time
    """

    row: int
    first: int
    last: int
    speed_mm_s: float
    share: float


@dataclass(frozen=True, slots=True)
class Observations:
    """Means of cells along lines, or of parts of standstills.

    at : conditions of the cells; `line` counts passes, -1 at a standstill
    tracker_mm : (n, 3) mean point in the tracker's frame
    count : (n,) samples in the mean
    direction : (n, 3) unit direction of travel, 0 at a standstill
    row : (n,) row of the commanded path or points
    scatter : (2,) standard deviation of samples about their cell along and across the
        beam, in units of the tracker's stated noise
    pose : rough pose, workpiece to tracker; estimation refines it
    used, offered : samples that went into cells, samples of the stream
    """

    at: Conditions
    tracker_mm: Float64[np.ndarray, "n 3"]
    count: Float64[np.ndarray, " n"]
    direction: Float64[np.ndarray, "n 3"]
    row: Int64[np.ndarray, " n"]
    scatter: Float64[np.ndarray, "2"]
    pose: RigidTransform
    passes: tuple[Pass, ...]
    used: int
    offered: int

    def __len__(self) -> int:
        return len(self.tracker_mm)

    def select(self, cells: Int64[np.ndarray, " m"]) -> Observations:
        """Return some of the cells."""
        return replace(
            self,
            at=self.at.select(cells),
            tracker_mm=self.tracker_mm[cells],
            count=self.count[cells],
            direction=self.direction[cells],
            row=self.row[cells],
        )


def find_lines(observations: Observations) -> list[tuple[int, int]]:
    """Return first cell and one past the last of each line or standstill."""
    line, row = observations.at.line, observations.row
    new = (np.diff(line) != 0) | (np.diff(row) != 0)
    begin = np.flatnonzero(np.concatenate([[True], new]))
    end = np.append(begin[1:], len(observations))
    return list(zip(begin.tolist(), end.tolist(), strict=True))
