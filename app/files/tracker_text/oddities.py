"""What a stream has that its user should look at: long gaps, positions that stay."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from truepath.drivers.interfaces.records import TrackerSamples

_LONG_GAP_S, _STUCK_ROWS = 10.0, 50
_MOST_NOTES = 3  # of each kind


def note_oddities(row_of: NDArray[np.int64], samples: TrackerSamples) -> list[str]:
    """Return words on long gaps of a stream, and on positions that stay."""
    notes: list[str] = []
    gap_s = np.diff(samples.device_time_s)
    for k in np.flatnonzero(gap_s > _LONG_GAP_S)[:_MOST_NOTES].tolist():
        notes.append(f"a gap of {gap_s[k]:.6g} s before row {row_of[k + 1]}")
    same = (np.diff(samples.position_mm, axis=0) == 0.0).all(axis=1)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], same.view(np.int8), [0]])))
    for first, last in edges.reshape(-1, 2).tolist():
        if last - first >= _STUCK_ROWS and len(notes) < 2 * _MOST_NOTES:
            rows = f"{row_of[first]} to {row_of[last]}"
            notes.append(f"rows {rows} repeat one position: was the beam lost?")
    return notes
