"""White plus Ornstein–Uhlenbeck noise: exact generalised least squares in linear time.

Every observation k is a point in space. Its noise is white with a 3×3 precision D_k⁻¹,
plus three Ornstein–Uhlenbeck processes c_k (air, mount, electronics), one a
coordinate. The Ornstein–Uhlenbeck part's precision is tridiagonal in time, so with V =
D + C,

    V⁻¹ = D⁻¹ − D⁻¹ (D⁻¹ + C⁻¹)⁻¹ D⁻¹,

and D⁻¹ + C⁻¹ is a band of width three when coordinates are interleaved. D⁻¹ may be
singular: a direction of no information (along the travel, say) has precision 0.

Points may also come a few at a time (`extended`). What follows tells more about the
slow part of the last point, so that one waits; all before it are accounted for.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int64
from scipy.linalg import (
    cho_solve_banded,
    cholesky_banded,
    solve_triangular,
    solveh_banded,
)
from scipy.linalg.lapack import dtbtrs

_BAND = 3
_ROUNDING = 1e-12  # of the largest precision: no information


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
    ) -> tuple[Float64[np.ndarray, "m p"], Float64[np.ndarray, "s p"]]:
        """Return (A, Z) with rowsᵀ V⁻¹ rows = AᵀA − ZᵀZ."""
        white = self.root @ rows
        flat = white.reshape(-1, rows.shape[2])
        if not self.factor.size:
            return flat, np.zeros((0, rows.shape[2]))
        pulled = (np.swapaxes(self.root, 1, 2) @ white).reshape(flat.shape)
        return flat, _solved(self.factor, pulled)

    def applied(
        self, rows: Float64[np.ndarray, "n 3 p"]
    ) -> Float64[np.ndarray, "n 3 p"]:
        """Return V⁻¹ rows."""
        precision = np.swapaxes(self.root, 1, 2) @ self.root
        weighted = precision @ rows
        if not self.factor.size:
            return weighted
        flat = weighted.reshape(-1, rows.shape[2])
        ou = cho_solve_banded((self.factor, True), flat).reshape(rows.shape)
        return weighted - precision @ ou


def whitener(
    time_s: Float64[np.ndarray, " n"],
    white_precision: Float64[np.ndarray, "n 3 3"],
    ou_sigma: Float64[np.ndarray, "n 3"],
    ou_time_s: float,
) -> Whitener:
    """Return V⁻¹ for white noise of the given precision and an Ornstein–Uhlenbeck part.

    time_s : increasing; ou_sigma : standard deviation of the Ornstein–Uhlenbeck part, 0
        for none
    """
    root, log_white = _white_root(white_precision)
    if not ou_sigma.any():
        return Whitener(root, np.empty((0, 0)), log_white)
    ou = ou_precision(time_s, ou_sigma, ou_time_s)
    band = _interleaved(white_precision, ou.diagonal, ou.below)
    factor = cholesky_banded(band, lower=True, check_finite=False)
    log_sum = 2.0 * float(np.log(factor[0]).sum())
    return Whitener(root, factor, log_white + ou.log_determinant + log_sum)


@dataclass(frozen=True, slots=True)
class OrnsteinUhlenbeckPrecision:
    """C⁻¹, tridiagonal in time for each coordinate.

    diagonal : (n, 3); below : (n, 3), from each point to the next, the last one 0
    log_determinant : of C
    """

    diagonal: Float64[np.ndarray, "n 3"]
    below: Float64[np.ndarray, "n 3"]
    log_determinant: float

    def times(self, ou: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 3"]:
        """Return C⁻¹ times a vector."""
        product = self.diagonal * ou
        product[:-1] += self.below[:-1] * ou[1:]
        product[1:] += self.below[:-1] * ou[:-1]
        return product

    def solved(self, right: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 3"]:
        """Return C times a vector."""
        none = np.zeros((len(right), 3, 3))
        band = _interleaved(none, self.diagonal, self.below)
        solved = solveh_banded(band, right.ravel(), lower=True, check_finite=False)
        return solved.reshape(right.shape)


def ou_precision(
    time_s: Float64[np.ndarray, " n"],
    sigma: Float64[np.ndarray, "n 3"],
    ou_time_s: float,
) -> OrnsteinUhlenbeckPrecision:
    """Return C⁻¹ for a given standard deviation and correlation time."""
    step = np.diff(time_s)
    keep = np.exp(-step / ou_time_s)
    # −expm1 keeps its digits where steps are far shorter than the correlation time.
    fresh = np.maximum(-np.expm1(-2.0 * step / ou_time_s), 1e-12)
    unit = np.ones(len(time_s))
    unit[:-1] += keep**2 / fresh
    unit[1:] += 1.0 / fresh - 1.0
    below = np.zeros(len(time_s))
    below[:-1] = -keep / fresh
    scaled_below = below[:, None] / (sigma * np.roll(sigma, -1, axis=0))
    log_c = 2.0 * float(np.log(sigma).sum()) + 3.0 * float(np.log(fresh).sum())
    return OrnsteinUhlenbeckPrecision(unit[:, None] / sigma**2, scaled_below, log_c)


@dataclass(frozen=True, slots=True)
class Tail:
    """The last point so far: its correlated noise given all points, itself included.

    sigma : (3,) of the Ornstein–Uhlenbeck part
    precision : (3, 3) of the Ornstein–Uhlenbeck part, what follows not yet counted
    pulled : (3, p), precision times the Ornstein–Uhlenbeck part's mean, as a function
        of the columns
    """

    time_s: float
    sigma: Float64[np.ndarray, "3"]
    precision: Float64[np.ndarray, "3 3"]
    pulled: Float64[np.ndarray, "3 p"]

    def taken(self) -> tuple[Float64[np.ndarray, "p p"], float]:
        """Return what the tail takes from rowsᵀ V⁻¹ rows, and its share of log det V.

        Valid as long as nothing follows.
        """
        factor = np.linalg.cholesky(self.precision)
        solved = solve_triangular(factor, self.pulled, lower=True)
        return solved.T @ solved, 2.0 * float(np.log(np.diag(factor)).sum())


def without_columns(
    total: Float64[np.ndarray, "q q"],
    tail: Tail | None,
    kept: Int64[np.ndarray, " k"],
    rest: Int64[np.ndarray, " r"],
) -> tuple[Float64[np.ndarray, "k k"], float, Tail | None]:
    """Integrate columns out that no later point has; exact, whatever follows.

    With the Ornstein–Uhlenbeck part c of the last point, sums so far are the quadratic
    form wᵀ total w − 2 cᵀ pulled w + cᵀ precision c. Returns total and tail over the
    columns kept, and what is added to the log determinant. Raises LinAlgError if the
    points do not determine the rest.
    """
    square = total[np.ix_(kept, kept)]
    if not len(rest):
        pulled = None if tail is None else replace(tail, pulled=tail.pulled[:, kept])
        return square, 0.0, pulled
    H = total[np.ix_(rest, rest)]
    scale = 1.0 / np.sqrt(np.diag(H))
    factor = np.linalg.cholesky(H * scale[:, None] * scale)
    half = _lower(factor, total[np.ix_(rest, kept)] * scale[:, None])
    square -= half.T @ half
    turned = 2.0 * float(np.log(np.diag(factor)).sum() - np.log(scale).sum())
    if tail is None:
        return square, turned, None
    r = _lower(factor, (tail.pulled[:, rest] * scale).T)
    pulled = tail.pulled[:, kept] - r.T @ half
    left = replace(tail, pulled=pulled, precision=tail.precision - r.T @ r)
    return square, turned, left


def extended(
    tail: Tail | None,
    time_s: Float64[np.ndarray, " n"],
    white_precision: Float64[np.ndarray, "n 3 3"],
    ou_sigma: Float64[np.ndarray, "n 3"],
    ou_time_s: float,
    rows: Float64[np.ndarray, "n 3 p"],
) -> tuple[Float64[np.ndarray, "p p"], float, Tail | None]:
    """Return what further points add to rowsᵀ V⁻¹ rows and log det V, and their tail.

    tail : of the points before; None if these are the first, or the noise is white
    The sums are those of `whitener` once the last tail's share is taken.
    """
    root, log_white = _white_root(white_precision)
    white = root @ rows
    flat = white.reshape(-1, rows.shape[2])
    if not ou_sigma.any():
        return flat.T @ flat, log_white, None
    pulled = (np.swapaxes(root, 1, 2) @ white).reshape(flat.shape)
    if tail is not None:
        time_s = np.concatenate([[tail.time_s], time_s])
        ou_sigma = np.concatenate([tail.sigma[None], ou_sigma])
        white_precision = np.concatenate([tail.precision[None], white_precision])
        pulled = np.concatenate([tail.pulled, pulled])
    ou = ou_precision(time_s, ou_sigma, ou_time_s)
    log_slow = ou.log_determinant
    if tail is not None:  # counted when the tail was the newest point
        ou.diagonal[0] -= 1.0 / tail.sigma**2
        log_slow -= 2.0 * float(np.log(tail.sigma).sum())
    band = _interleaved(white_precision, ou.diagonal, ou.below)
    factor = cholesky_banded(band, lower=True, check_finite=False)
    solved = _solved(factor, pulled)
    settled = solved[:-3]
    log_sum = 2.0 * float(np.log(factor[0, :-3]).sum())
    last = _last_block(factor)
    left = Tail(float(time_s[-1]), ou_sigma[-1], last @ last.T, last @ solved[-3:])
    gain = flat.T @ flat - settled.T @ settled
    return gain, log_white + log_slow + log_sum, left


def _white_root(
    white_precision: Float64[np.ndarray, "n 3 3"],
) -> tuple[Float64[np.ndarray, "n 3 3"], float]:
    """Return an upper W with WᵀW = D⁻¹, and log det D over what has information.

    Cholesky's factor for all points at once; a pivot of rounding counts as none.
    """
    root = np.zeros_like(white_precision)
    least = _ROUNDING * np.trace(white_precision, axis1=1, axis2=2)
    log_determinant = 0.0
    for i in range(3):
        above = root[:, :i, i]
        pivot = white_precision[:, i, i] - np.einsum("nk,nk->n", above, above)
        known = pivot > least
        root[:, i, i] = np.sqrt(np.where(known, pivot, 0.0))
        log_determinant -= float(np.log(pivot[known]).sum())
        for j in range(i + 1, 3):
            rest = white_precision[:, i, j] - np.einsum(
                "nk,nk->n", above, root[:, :i, j]
            )
            root[known, i, j] = rest[known] / root[known, i, i]
    return root, log_determinant


def _solved(
    factor: Float64[np.ndarray, "b m"], right: Float64[np.ndarray, "m p"]
) -> Float64[np.ndarray, "m p"]:
    solved, info = dtbtrs(factor, np.asfortranarray(right), uplo="L")
    if info:
        raise np.linalg.LinAlgError(f"banded solve failed ({info})")
    return solved


def _lower(
    factor: Float64[np.ndarray, "r r"], right: Float64[np.ndarray, "r p"]
) -> Float64[np.ndarray, "r p"]:
    return solve_triangular(factor, right, lower=True, check_finite=False)


def _last_block(factor: Float64[np.ndarray, "4 m"]) -> Float64[np.ndarray, "3 3"]:
    """Return the lower triangle that belongs to the last point."""
    block = np.diag(factor[0, -3:])
    block[1, 0], block[2, 1], block[2, 0] = factor[1, -3], factor[1, -2], factor[2, -3]
    return block


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
