"""Legendre polynomials of positions within a travel, and products of two of them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from jaxtyping import Float64
from numpy.polynomial import legendre


def expand_share(
    share: Float64[np.ndarray, " n"], degree: int
) -> Float64[np.ndarray, "n d"]:
    """Polynomials of degree 0 to `degree` at shares from 0 to 1."""
    return legendre.legvander(2.0 * share - 1.0, degree)


def multiply_shares(
    shares: Iterable[Float64[np.ndarray, " n"]], degrees: Sequence[tuple[int, int]]
) -> Float64[np.ndarray, "n p"]:
    """One product of polynomials of two shares per pair of degrees."""
    highest = max(map(max, degrees))
    one, two = (expand_share(share, highest) for share in shares)
    return np.stack([one[:, i] * two[:, j] for i, j in degrees], axis=1)
