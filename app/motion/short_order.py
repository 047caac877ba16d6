"""The order of stops that takes least time, the first one given."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64, Int64

_LEAST_S = 1e-9  # a gain beyond rounding


def find_short_order(time_s: Float64[np.ndarray, "n n"]) -> Int64[np.ndarray, " n"]:
    """Return the stops in an order from which turning any stretch round gains nothing.

    time_s : of the move between any two, symmetric; infinite where it is not allowed
    The order as it is must be allowed. Croes (1958), the end being free.
    """
    order = np.arange(len(time_s))
    while True:
        gain, first, last = _best_turn(time_s, order)
        if gain < _LEAST_S:
            return order
        order[first : last + 1] = order[first : last + 1][::-1].copy()


def _best_turn(
    time_s: Float64[np.ndarray, "n n"], order: Int64[np.ndarray, " n"]
) -> tuple[float, int, int]:
    """Return what turning the stretch first … last round gains, the best of all."""
    between = time_s[np.ix_(order, order)]
    n = len(order)
    if n < 3:
        return 0.0, 0, 0
    step = np.append(np.diagonal(between, 1), 0.0)  # nothing follows the last stop
    after = np.hstack([between[:, 1:], np.zeros((n, 1))])
    # Before: i−1 → i … j → j+1; turned round: i−1 → j … i → j+1.
    gain = step[:-1, None] + step[None, 1:] - between[:-1, 1:] - after[1:, 1:]
    gain = np.triu(np.where(np.isfinite(gain), gain, -np.inf), 1)
    i, j = np.unravel_index(int(np.argmax(gain)), gain.shape)
    return float(gain[i, j]), int(i) + 1, int(j) + 1
