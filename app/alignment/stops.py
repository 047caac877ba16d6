"""Standstill recognition: where in the stream the machine stood still.

The paper's predecessor (Montavon 2019) measures at these; on the fly they are the exact
stops at the waypoints, whose *sequence* tells which line is which.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

SPEED_BLOCK = 10  # samples on either side: 20 ms at 500 Hz
SAME_PLACE_MM = 0.1  # nearer than this two standstills are one


@dataclass(frozen=True, slots=True)
class StopSequence:
    """Standstills in the order of time.

    first, last : (m,) indices of the first sample at rest and of the one after the last
    position_mm : (m, 3) where, in the frame of the stream
    """

    first: Int64[np.ndarray, " m"]
    last: Int64[np.ndarray, " m"]
    position_mm: Float64[np.ndarray, "m 3"]

    def __len__(self) -> int:
        return len(self.first)


def speed_mm_s(
    time_s: Float64[np.ndarray, " n"], position_mm: Float64[np.ndarray, "n 3"]
) -> Float64[np.ndarray, " n"]:
    """Return the speed from the block before each sample to the block after it."""
    n, w = len(time_s), min(SPEED_BLOCK, max(1, len(time_s) // 3))
    stacked = np.column_stack([time_s - time_s[0], position_mm - position_mm[0]])
    total = np.vstack([np.zeros(4), np.cumsum(stacked, axis=0)])
    means = (total[w:] - total[:-w]) / w
    step = means[w:] - means[:-w]
    speed = np.linalg.norm(step[:, 1:], axis=1) / step[:, 0]
    return np.pad(speed, (w, n - w - len(speed)), mode="edge")


def find_stops(
    time_s: Float64[np.ndarray, " n"],
    position_mm: Float64[np.ndarray, "n 3"],
    slowest_mm_s: float,
) -> StopSequence:
    """Find the standstills of a stream whose slowest motion is known.

    time_s, position_mm : valid samples only
    """
    threshold = standstill_speed_mm_s(slowest_mm_s)
    still = speed_mm_s(time_s, position_mm) < threshold
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.view(np.int8), [0]])))
    first, last = edges[::2], edges[1::2]
    if len(first) == 0:
        return StopSequence(first, last, np.empty((0, 3)))
    where = np.array(
        [rest_position_mm(position_mm[a:b]) for a, b in zip(first, last, strict=True)]
    )
    return _merge(first, last, where, position_mm)


def standstill_speed_mm_s(slowest_mm_s: float) -> float:
    """Return the speed below which the machine stands, its slowest motion known."""
    return float(np.clip(0.2 * slowest_mm_s, 0.5, 20.0))


def rest_position_mm(
    position_mm: Float64[np.ndarray, "n 3"],
) -> Float64[np.ndarray, "3"]:
    """Return where a standstill was: the median of its middle half."""
    quarter = len(position_mm) // 4
    middle = position_mm[quarter : len(position_mm) - quarter]
    return np.median(middle, axis=0)


def leaves_between(
    between_mm: Float64[np.ndarray, "n 3"], place_mm: Float64[np.ndarray, "3"]
) -> bool:
    """Tell whether the target was away between two standstills at one place.

    So it is after a full turn of a rotary axis; a spike or a lost frame is no motion.
    """
    if not len(between_mm):
        return False
    away = np.linalg.norm(between_mm - place_mm, axis=1)
    return bool(np.median(away) > SAME_PLACE_MM)


def _merge(
    first: Int64[np.ndarray, " m"],
    last: Int64[np.ndarray, " m"],
    where: Float64[np.ndarray, "m 3"],
    position_mm: Float64[np.ndarray, "n 3"],
) -> StopSequence:
    """Join neighbours at one place: a lost frame does not make two standstills."""
    moved = np.linalg.norm(np.diff(where, axis=0), axis=1) > SAME_PLACE_MM
    for k in np.flatnonzero(~moved):
        moved[k] = leaves_between(position_mm[last[k] : first[k + 1]], where[k])
    begins = np.flatnonzero(np.concatenate([[True], moved]))
    ends = np.append(begins[1:], len(first)) - 1
    longest = [
        b + int(np.argmax(last[b : e + 1] - first[b : e + 1]))
        for b, e in zip(begins, ends, strict=True)
    ]
    return StopSequence(first[begins], last[ends], where[longest])
