"""Noise with a white and a slow part: exact generalised least squares in linear time.

Every observation k is a point in space. Its noise is white with a 3×3 precision D_k⁻¹,
plus three slow processes c_k (Ornstein–Uhlenbeck: air, mount, electronics), one a
coordinate. The slow part's precision is tridiagonal in time, so with V = D + C,

    V⁻¹ = D⁻¹ − D⁻¹ (D⁻¹ + C⁻¹)⁻¹ D⁻¹,

and D⁻¹ + C⁻¹ is a band of width three when coordinates are interleaved. D⁻¹ may be
singular: a direction of no information (along the travel, say) has precision 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.linalg import cholesky_banded
from scipy.linalg.lapack import dtbtrs

_BAND = 3


@dataclass(frozen=True, slots=True)
class Whitener:
    """V⁻¹ of n points in order of time, ready for products.

    root : (n, 3, 3), W with WᵀW = D⁻¹
    factor : (4, 3n), banded Cholesky factor of D⁻¹ + C⁻¹, or empty for white noise
    log_determinant : of V, up to the constant of directions without information
    """

    root: Float64[np.ndarray, "n 3 3"]
    factor: Float64[np.ndarray, "b m"]
    log_determinant: float

    def halves(
        self, rows: Float64[np.ndarray, "n 3 p"]
    ) -> tuple[Float64[np.ndarray, "m p"], Float64[np.ndarray, "m p"]]:
        """Return (A, Z) with rowsᵀ V⁻¹ rows = AᵀA − ZᵀZ."""
        white = self.root @ rows
        flat = white.reshape(-1, rows.shape[2])
        if not self.factor.size:
            return flat, np.zeros((0, rows.shape[2]))
        pulled = (np.swapaxes(self.root, 1, 2) @ white).reshape(flat.shape)
        solved, info = dtbtrs(self.factor, np.asfortranarray(pulled), uplo="L")
        if info:
            raise np.linalg.LinAlgError(f"banded solve failed ({info})")
        return flat, solved


def whitener(
    time_s: Float64[np.ndarray, " n"],
    white_precision: Float64[np.ndarray, "n 3 3"],
    slow_sigma: Float64[np.ndarray, "n 3"],
    slow_time_s: float,
) -> Whitener:
    """Return V⁻¹ for white noise of the given precision and a slow part.

    time_s : increasing; slow_sigma : standard deviation of the slow part, 0 for none
    """
    eigenvalue, vector = np.linalg.eigh(white_precision)
    eigenvalue = np.maximum(eigenvalue, 0.0)
    root = np.sqrt(eigenvalue)[:, :, None] * np.swapaxes(vector, 1, 2)
    known = eigenvalue > 1e-12 * eigenvalue.max(axis=1, keepdims=True)
    log_white = -float(np.log(eigenvalue[known]).sum())
    if not slow_sigma.any():
        return Whitener(root, np.empty((0, 0)), log_white)
    diagonal, below, log_slow = _slow_precision(time_s, slow_sigma, slow_time_s)
    band = _interleaved(white_precision, diagonal, below)
    factor = cholesky_banded(band, lower=True, check_finite=False)
    log_sum = 2.0 * float(np.log(factor[0]).sum())
    return Whitener(root, factor, log_white + log_slow + log_sum)


def _slow_precision(
    time_s: Float64[np.ndarray, " n"], sigma: Float64[np.ndarray, "n 3"], tau_s: float
) -> tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n 3"], float]:
    """Return diagonal and sub-diagonal of C⁻¹, and log det C."""
    step = np.diff(time_s)
    keep = np.exp(-step / tau_s)
    # −expm1 keeps its digits where steps are far shorter than the correlation time.
    fresh = np.maximum(-np.expm1(-2.0 * step / tau_s), 1e-12)
    unit = np.ones(len(time_s))
    unit[:-1] += keep**2 / fresh
    unit[1:] += 1.0 / fresh - 1.0
    below = np.zeros(len(time_s))
    below[:-1] = -keep / fresh
    scaled_below = below[:, None] / (sigma * np.roll(sigma, -1, axis=0))
    log_c = 2.0 * float(np.log(sigma).sum()) + 3.0 * float(np.log(fresh).sum())
    return unit[:, None] / sigma**2, scaled_below, log_c


def _interleaved(
    white: Float64[np.ndarray, "n 3 3"],
    diagonal: Float64[np.ndarray, "n 3"],
    below: Float64[np.ndarray, "n 3"],
) -> Float64[np.ndarray, "4 m"]:
    n = len(white)
    band = np.zeros((_BAND + 1, n, 3))
    for j in range(3):
        band[0, :, j] = white[:, j, j] + diagonal[:, j]
        for i in range(j + 1, 3):
            band[i - j, :, j] = white[:, i, j]
    band[_BAND] = below
    return band.reshape(_BAND + 1, 3 * n)
