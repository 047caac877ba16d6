"""Sums of data times waves, for thousands of waves at once."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64
from numpy.typing import NDArray
from scipy.fft import next_fast_len, rfft

_FINE, _PADDED = 6, 4  # grid points to the shortest wave, and its length over the data


def transform(
    coordinate: Float64[np.ndarray, " n"],
    data: Float64[np.ndarray, " n"],
    waves: Float64[np.ndarray, " v"],
) -> NDArray[np.complex128]:
    """Σ data exp(−2πi coordinate · wave), by linear weights on a fine grid."""
    first, step = float(coordinate.min()), 1.0 / (_FINE * float(waves.max()))
    place = (coordinate - first) / step
    left = np.floor(place).astype(np.int64)
    size = next_fast_len(_PADDED * (int(left.max()) + 2), real=True)
    part = place - left
    grid = np.bincount(left, data * (1.0 - part), size)
    grid += np.bincount(left + 1, data * part, size)
    found = rfft(grid)
    at_wave = waves * size * step
    index = np.minimum(at_wave.astype(np.int64), len(found) - 2)
    share = at_wave - index
    # Seen from the middle of the data, neighbours differ least in phase.
    middle = int(left.max()) // 2
    turn = middle / size
    value = found[index] * (1.0 - share)
    value += found[index + 1] * np.exp(2j * np.pi * turn) * share
    phase = np.exp(2j * np.pi * (turn * index - (first + middle * step) * waves))
    return np.asarray(value * phase / np.sinc(waves * step) ** 2, np.complex128)
