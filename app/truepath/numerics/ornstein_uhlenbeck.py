"""Precision of Ornstein–Uhlenbeck noise, one process per coordinate of the points.

It is tridiagonal in time, and a band of width three where coordinates are interleaved.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.linalg import solveh_banded

_BAND = 3


@dataclass(frozen=True, slots=True)
class OrnsteinUhlenbeckPrecision:
    """C⁻¹, tridiagonal in time for each coordinate.

    diagonal : (n, 3); below : (n, 3), from each point to the next, the last one 0
    alone : (n, 3) precision of each point given the one before
    log_determinant : of C
    """

    diagonal: Float64[np.ndarray, "n 3"]
    below: Float64[np.ndarray, "n 3"]
    alone: Float64[np.ndarray, "n 3"]
    log_determinant: float

    def multiply(self, ou: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 3"]:
        """C⁻¹ times a vector."""
        product = self.diagonal * ou
        product[:-1] += self.below[:-1] * ou[1:]
        product[1:] += self.below[:-1] * ou[:-1]
        return product

    def solve(self, right: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 3"]:
        """C times a vector."""
        none = np.zeros((len(right), 3, 3))
        band = interleave(none, self.diagonal, self.below)
        solved = solveh_banded(band, right.ravel(), lower=True, check_finite=False)
        return solved.reshape(right.shape)


def build_ou_precision(
    time_s: Float64[np.ndarray, " n"],
    sigma: Float64[np.ndarray, "n 3"],
    ou_time_s: float,
) -> OrnsteinUhlenbeckPrecision:
    """C⁻¹ for a standard deviation per point and a correlation time."""
    step = np.diff(time_s)
    keep = np.exp(-step / ou_time_s)
    # −expm1 keeps its digits where steps are far shorter than the correlation time.
    fresh = np.maximum(-np.expm1(-2.0 * step / ou_time_s), 1e-12)
    alone = np.ones(len(time_s))
    alone[1:] = 1.0 / fresh
    unit = alone.copy()
    unit[:-1] += keep**2 / fresh
    below = np.zeros(len(time_s))
    below[:-1] = -keep / fresh
    scaled_below = below[:, None] / (sigma * np.roll(sigma, -1, axis=0))
    log_c = 2.0 * float(np.log(sigma).sum()) + 3.0 * float(np.log(fresh).sum())
    diagonal, alone = (each[:, None] / sigma**2 for each in (unit, alone))
    return OrnsteinUhlenbeckPrecision(diagonal, scaled_below, alone, log_c)


def interleave(
    white: Float64[np.ndarray, "n 3 3"],
    diagonal: Float64[np.ndarray, "n 3"],
    below: Float64[np.ndarray, "n 3"],
) -> Float64[np.ndarray, "4 m"]:
    """Lower band of white precisions, or zeros, plus such a precision.

    diagonal, below : of the process, as in `OrnsteinUhlenbeckPrecision`
    """
    n = len(white)
    band = np.zeros((_BAND + 1, n, 3))
    for j in range(3):
        band[0, :, j] = white[:, j, j] + diagonal[:, j]
        for i in range(j + 1, 3):
            band[i - j, :, j] = white[:, i, j]
    band[_BAND] = below
    return band.reshape(_BAND + 1, 3 * n)
