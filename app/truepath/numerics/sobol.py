"""Sobol points: evenly spread over a box of few dimensions, the same in every call.

The very points of `scipy.stats.qmc.Sobol`, whose import costs a third of a second, in
every process that analyses.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

_BITS = 30
# Primitive polynomials and first direction numbers of Joe and Kuo (2008).
_POLYNOMIALS = (1, 3, 7, 11, 13, 19)
_FIRST = ((1,), (1,), (1, 3), (1, 3, 1), (1, 1, 1), (1, 1, 3, 3))
MOST_DIMENSIONS = len(_POLYNOMIALS)


def compute_sobol_points(dimensions: int, count: int) -> Float64[np.ndarray, "n d"]:
    """The first points in the unit cube, scrambled by Matoušek's linear scramble."""
    rng = np.random.default_rng(0).spawn(1)[0]
    digit = 2 ** np.arange(_BITS, dtype=np.uint32)
    draw = rng.integers(2, size=(dimensions, _BITS), dtype=np.uint32)
    shift = draw @ digit
    draw = rng.integers(2, size=(dimensions, _BITS, _BITS), dtype=np.uint32)
    scramble = np.tril(draw, -1) + np.eye(_BITS, dtype=np.uint32)
    numbers = np.stack([_compute_direction_numbers(d) for d in range(dimensions)])
    # Binary digits, the most significant first; sums of digits count modulo two.
    digits = numbers[..., None] // digit[::-1] % 2
    numbers = np.einsum("dpk,djk->djp", scramble, digits) % 2 @ digit[::-1]
    # Each point differs from the one before by one direction number (Gray's code).
    index = np.arange(1, count)
    changed = np.bitwise_count((index ^ (index - 1)) >> 1)
    steps = np.concatenate([shift[:, None], numbers[:, changed]], axis=1)
    return np.bitwise_xor.accumulate(steps, axis=1).T / 2.0**_BITS


def _compute_direction_numbers(dimension: int) -> np.ndarray:
    polynomial, known = _POLYNOMIALS[dimension], list(_FIRST[dimension])
    if dimension == 0:
        known = [1] * _BITS
    degree = polynomial.bit_length() - 1
    for j in range(len(known), _BITS):
        new = known[j - degree]
        for k in range(degree):
            if polynomial >> (degree - 1 - k) & 1:
                new ^= known[j - k - 1] << (k + 1)
        known.append(new)
    return np.array(
        [number << (_BITS - 1 - j) for j, number in enumerate(known)], np.uint32
    )
