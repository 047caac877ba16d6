"""Chains of standstills and waypoints in one order, by dynamic programming."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64, Int64

SKIP = 4  # how many standstills or waypoints in a row may be missing
FEWEST_ASTRAY = 3  # standstills in a row off all points; fewer occur on any machine


def find_longest_chain(
    places: Float64[np.ndarray, "m 3"],
    waypoints: Float64[np.ndarray, "w 3"],
    within: Float64[np.ndarray, "w w"],
) -> tuple[Int64[np.ndarray, " k"], Int64[np.ndarray, " k"]]:
    """Longest chain of pairs (standstill, waypoint) with few skips.

    A link is allowed where the distance to the previous pair fits, and to the pair
    before that one as well; each pair adds one, each skip costs a little.

    within : tolerance on the distance of two waypoints
    """
    m, w = len(places), len(waypoints)
    score = np.ones((m, w))
    back = np.full((m, w, 2), -1)
    nominal = np.linalg.norm(waypoints[:, None] - waypoints[None], axis=2)
    for i in range(1, m):
        for di in range(1, min(SKIP, i) + 1):
            j = i - di
            step = float(np.linalg.norm(places[i] - places[j]))
            for da in range(1, min(SKIP, w - 1) + 1):
                a, b = np.arange(da, w), np.arange(w - da)
                fits = np.abs(nominal[a, b] - step) < within[a, b]
                fits &= _fits_two_back(places, nominal, within, back, i, j, a, b)
                better = score[j, b] + 1.0 - 0.2 * (di + da - 2)
                take = fits & (better > score[i, a])
                score[i, a[take]] = better[take]
                back[i, a[take]] = np.column_stack([np.full(take.sum(), j), b[take]])
    return _trace_back(score, back)


def _fits_two_back(
    places: Float64[np.ndarray, "m 3"],
    nominal: Float64[np.ndarray, "w w"],
    within: Float64[np.ndarray, "w w"],
    back: Int64[np.ndarray, "m w 2"],
    i: int,
    j: int,
    a: Int64[np.ndarray, " n"],
    b: Int64[np.ndarray, " n"],
) -> np.ndarray:
    earlier, waypoint = back[j, b, 0], back[j, b, 1]
    distance = np.linalg.norm(places[i] - places[earlier], axis=1)
    off = np.abs(nominal[a, waypoint] - distance)
    return (earlier < 0) | (off < within[a, waypoint])


def _trace_back(
    score: Float64[np.ndarray, "m w"], back: Int64[np.ndarray, "m w 2"]
) -> tuple[Int64[np.ndarray, " k"], Int64[np.ndarray, " k"]]:
    if score.size == 0:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    i, a = (int(v) for v in np.unravel_index(int(np.argmax(score)), score.shape))
    chain: list[tuple[int, int]] = []
    while i >= 0:
        chain.append((i, a))
        i, a = int(back[i, a, 0]), int(back[i, a, 1])
    pairs = np.array(chain[::-1])
    return pairs[:, 0], pairs[:, 1]


def match_points(
    places: Float64[np.ndarray, "m 3"],
    expected: Float64[np.ndarray, "w 3"],
    within: float | Float64[np.ndarray, " w"],
) -> tuple[Int64[np.ndarray, " k"], Int64[np.ndarray, " k"]]:
    """Pairs within tolerance, as the longest common subsequence of both orders."""
    m, w = len(places), len(expected)
    near = np.linalg.norm(places[:, None] - expected[None], axis=2) < within
    length = np.zeros((m + 1, w + 1), np.int64)
    for i in range(m):
        hit = length[i, :-1] + near[i]
        length[i + 1, 1:] = np.maximum.accumulate(np.maximum(hit, length[i, 1:]))
    pairs: list[tuple[int, int]] = []
    i, a = m, w
    while i and a:
        if length[i, a] == length[i - 1, a]:
            i -= 1
        elif length[i, a] == length[i, a - 1]:
            a -= 1
        else:
            i, a = i - 1, a - 1
            pairs.append((i, a))
    found = np.array(pairs[::-1]).reshape(-1, 2)
    return found[:, 0], found[:, 1]
