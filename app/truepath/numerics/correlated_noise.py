"""White plus Ornstein–Uhlenbeck noise: exact generalised least squares in linear time.

Every observation k is a point in space. Its noise is white with a 3×3 precision D_k⁻¹,
plus three Ornstein–Uhlenbeck processes c_k (air, mount, electronics), one a coordinate.
The Ornstein–Uhlenbeck part's precision is tridiagonal in time, so with V = D + C,

    V⁻¹ = D⁻¹ − D⁻¹ (D⁻¹ + C⁻¹)⁻¹ D⁻¹,

and D⁻¹ + C⁻¹ is a band of width three when coordinates are interleaved. D⁻¹ may be
singular: a direction of no information (along the travel, say) has precision 0. The
band's factor also predicts every point from those before it (Kalman's filter in
information form); the innovations of the points, in units of their noise, are a root of
V⁻¹.

Points may also come a few at a time (`extend`). Later points give information about the
slow part of the last point, so that one stays open; all before it are accounted for.

LAPACK solves with a band row by row and column by column, limited by memory access. In
chunks of some rows the inverse is small and dense: most of the work is then products of
matrices, and only the last rows of a chunk are carried to the next (`BandedFactor`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float64, Int64
from scipy.linalg import cholesky_banded, solveh_banded

from truepath.numerics.scaled_cholesky import ScaledCholesky

_ROUNDING = 1e-12  # of the largest precision: no information
_CHUNK = 24  # rows: longer costs products with zeros, shorter more turns


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
    band = np.zeros((4, n, 3))
    for j in range(3):
        band[0, :, j] = white[:, j, j] + diagonal[:, j]
        for i in range(j + 1, 3):
            band[i - j, :, j] = white[:, i, j]
    band[3] = below
    return band.reshape(4, 3 * n)


@dataclass(frozen=True)
class Whitener:
    """V⁻¹ of n points in order of time, ready for products.

    root : (n, 3, 3), W with WᵀW = D⁻¹
    factor : (4, 3n), banded Cholesky factor of D⁻¹ + C⁻¹, or empty for white noise
    alone : (n, 3) precision of C's process, each point's given the one before
    log_determinant : of V, up to the constant of directions without information
    """

    root: Float64[np.ndarray, "n 3 3"]
    factor: Float64[np.ndarray, "b m"]
    alone: Float64[np.ndarray, "n 3"]
    log_determinant: float

    def whiten(self, rows: Float64[np.ndarray, "n 3 p"]) -> Float64[np.ndarray, "m p"]:
        """E with rowsᵀ V⁻¹ rows = EᵀE."""
        new = np.empty((3 * len(rows), rows.shape[2]))
        if not self.factor.size:
            np.matmul(self.root, rows, out=new.reshape(rows.shape))
            return new
        precision = np.swapaxes(self.root, 1, 2) @ self.root
        pulled = (precision @ rows).reshape(new.shape)
        self._innovations.write_innovations(rows, self._solver.solve_half(pulled), new)
        return new

    @cached_property
    def _solver(self) -> BandedFactor:
        return BandedFactor.of(self.factor)

    @cached_property
    def _innovations(self) -> _Innovations:
        return _Innovations.of(self.root, self.alone, self.factor)

    def apply(self, rows: Float64[np.ndarray, "n 3 p"]) -> Float64[np.ndarray, "n 3 p"]:
        """V⁻¹ rows."""
        return self.split(rows)[0]

    def split(
        self, rows: Float64[np.ndarray, "n 3 p"]
    ) -> tuple[Float64[np.ndarray, "n 3 p"], Float64[np.ndarray, "n 3 p"]]:
        """V⁻¹ rows, and the expected Ornstein–Uhlenbeck noise in rows."""
        precision = np.swapaxes(self.root, 1, 2) @ self.root
        weighted = precision @ rows
        if not self.factor.size or not rows.size:
            return weighted, np.zeros_like(rows)
        flat = weighted.reshape(-1, rows.shape[2])
        ou = self._solver.solve(flat).reshape(rows.shape)
        return weighted - precision @ ou, ou


def factorise(
    time_s: Float64[np.ndarray, " n"],
    white_precision: Float64[np.ndarray, "n 3 3"],
    ou_sigma: Float64[np.ndarray, "n 3"],
    ou_time_s: float,
) -> Whitener:
    """V⁻¹ for white noise of the given precision and an Ornstein–Uhlenbeck part.

    time_s : increasing; ou_sigma : standard deviation of the Ornstein–Uhlenbeck part, 0
        for none
    """
    root, log_white = _white_root(white_precision)
    if not ou_sigma.any():
        return Whitener(root, np.empty((0, 0)), np.empty((0, 3)), log_white)
    ou = build_ou_precision(time_s, ou_sigma, ou_time_s)
    band = interleave(white_precision, ou.diagonal, ou.below)
    factor = cholesky_banded(band, lower=True, check_finite=False)
    log_sum = 2.0 * float(np.log(factor[0]).sum())
    log_determinant = log_white + ou.log_determinant + log_sum
    return Whitener(root, factor, ou.alone, log_determinant)


@dataclass(frozen=True, slots=True)
class _Innovations:
    """Innovation of a point from its rows and the solution before it.

    own : (n, 3, 3) R; before : (k, 3, 3) N, of the last k points, which have one before
    """

    own: Float64[np.ndarray, "n 3 3"]
    before: Float64[np.ndarray, "k 3 3"]

    @staticmethod
    def of(
        root: Float64[np.ndarray, "n 3 3"],
        alone: Float64[np.ndarray, "m 3"],
        factor: Float64[np.ndarray, "4 b"],
    ) -> _Innovations:
        """For the last n of m points with a factor.

        With the factor's blocks B below its diagonal and the solution z, the process is
        predicted as c = −P B z, P⁻¹ = Q⁻¹ − B Bᵀ. The innovation is y − c, of
        covariance D + P.
        """
        block = np.zeros((len(alone) - 1, 3, 3))
        for i in range(3):
            for j in range(i, 3):
                block[:, i, j] = factor[3 + i - j, j:-3:3]
        precision = alone[:, :, None] * np.eye(3)
        precision[1:] -= block @ np.swapaxes(block, 1, 2)
        spread = np.linalg.inv(precision[-len(root) :])
        total = np.eye(3) + root @ spread @ np.swapaxes(root, 1, 2)
        own = np.linalg.solve(np.linalg.cholesky(total), root)
        last = slice(max(len(root) - len(block), 0), None)
        return _Innovations(own, own[last] @ spread[last] @ block)

    def write_innovations(
        self,
        rows: Float64[np.ndarray, "n 3 p"],
        solved: Float64[np.ndarray, "m p"],
        new: Float64[np.ndarray, "b p"],
    ) -> None:
        out, count = new.reshape(rows.shape), len(self.before)
        np.matmul(self.own, rows, out=out)
        solved = solved.reshape(-1, 3, rows.shape[2])
        out[len(out) - count :] += self.before @ solved[:-1]


@dataclass(frozen=True, slots=True)
class OrnsteinUhlenbeckState:
    """The correlated noise of the last point given all points, in information form.

    sigma : (3,) standard deviation of the process
    precision : (3, 3) of the state, without later points
    pulled : (3, p), precision times the mean of the state, as a function of the columns
    """

    time_s: float
    sigma: Float64[np.ndarray, "3"]
    precision: Float64[np.ndarray, "3 3"]
    pulled: Float64[np.ndarray, "3 p"]

    def marginalise(self) -> tuple[Float64[np.ndarray, "p p"], float]:
        """Share of the state in rowsᵀ V⁻¹ rows, and in log det V.

        Valid as long as no point follows.
        """
        factor = ScaledCholesky.of(self.precision)
        half = factor.solve_half(self.pulled)
        return half.T @ half, factor.log_determinant


def eliminate_columns(
    total: Float64[np.ndarray, "q q"],
    state: OrnsteinUhlenbeckState | None,
    kept: Int64[np.ndarray, " k"],
    rest: Int64[np.ndarray, " r"],
) -> tuple[Float64[np.ndarray, "k k"], float, OrnsteinUhlenbeckState | None]:
    """Integrate out columns that no later point has; exact, whatever follows.

    With the correlated noise c of the last point, sums so far are the quadratic form wᵀ
    total w − 2 cᵀ pulled w + cᵀ precision c. Returns total and state over the columns
    kept, and the change of the log determinant.
    Raises LinAlgError if the points do not determine the rest.
    """
    square = total[np.ix_(kept, kept)]
    if not len(rest):
        if state is not None:
            state = replace(state, pulled=state.pulled[:, kept])
        return square, 0.0, state
    factor = ScaledCholesky.of(total[np.ix_(rest, rest)])
    half = factor.solve_half(total[np.ix_(rest, kept)])
    square -= half.T @ half
    if state is not None:
        own = factor.solve_half(state.pulled[:, rest].T)
        pulled = state.pulled[:, kept] - own.T @ half
        precision = state.precision - own.T @ own
        state = replace(state, pulled=pulled, precision=precision)
    return square, factor.log_determinant, state


def extend(
    state: OrnsteinUhlenbeckState | None,
    time_s: Float64[np.ndarray, " n"],
    white_precision: Float64[np.ndarray, "n 3 3"],
    ou_sigma: Float64[np.ndarray, "n 3"],
    ou_time_s: float,
    rows: Float64[np.ndarray, "n 3 p"],
) -> tuple[Float64[np.ndarray, "p p"], float, OrnsteinUhlenbeckState | None]:
    """Contribution of further points to rowsᵀ V⁻¹ rows and log det V, and their state.

    state : after the points before; None if these are the first, or the noise is white
    The sums are those of `factorise` once the last state is marginalised.
    """
    root, log_white = _white_root(white_precision)
    columns = rows.shape[2]
    if not ou_sigma.any():
        flat = (root @ rows).reshape(-1, columns)
        return flat.T @ flat, log_white, None
    pulled = (white_precision @ rows).reshape(-1, columns)
    if state is not None:
        time_s = np.concatenate([[state.time_s], time_s])
        ou_sigma = np.concatenate([state.sigma[None], ou_sigma])
        white_precision = np.concatenate([state.precision[None], white_precision])
        pulled = np.concatenate([state.pulled, pulled])
    ou = build_ou_precision(time_s, ou_sigma, ou_time_s)
    log_ou = ou.log_determinant
    if state is not None:  # counted when the state was the newest
        ou.diagonal[0] -= 1.0 / state.sigma**2
        log_ou -= 2.0 * float(np.log(state.sigma).sum())
    band = interleave(white_precision, ou.diagonal, ou.below)
    factor = cholesky_banded(band, lower=True, check_finite=False)
    solved = BandedFactor.of(factor).solve_half(pulled)
    log_sum = 2.0 * float(np.log(factor[0, :-3]).sum())
    last = _last_block(factor)
    newest = OrnsteinUhlenbeckState(
        float(time_s[-1]), ou_sigma[-1], last @ last.T, last @ solved[-3:]
    )
    new = np.empty((3 * len(rows) + 3, columns))
    _Innovations.of(root, ou.alone, factor).write_innovations(rows, solved, new[:-3])
    new[-3:] = solved[-3:]  # the newest state is not marginalised
    gain = new.T @ new
    if state is not None:
        gain -= state.marginalise()[0]
    return gain, log_white + log_ou + log_sum, newest


def _white_root(
    white_precision: Float64[np.ndarray, "n 3 3"],
) -> tuple[Float64[np.ndarray, "n 3 3"], float]:
    """Upper W with WᵀW = D⁻¹, and log det D over the directions with information.

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


def _last_block(factor: Float64[np.ndarray, "4 m"]) -> Float64[np.ndarray, "3 3"]:
    block = np.diag(factor[0, -3:])
    block[1, 0], block[2, 1], block[2, 0] = factor[1, -3], factor[1, -2], factor[2, -3]
    return block


@dataclass(frozen=True, slots=True)
class BandedFactor:
    """A lower banded factor in chunks, ready to be solved.

    inverse : (c, k, k) of each chunk's diagonal block, of k rows
    corner : (c − 1, d, d) of L, from the last rows of a chunk to those of the next
    """

    inverse: Float64[np.ndarray, "c k k"]
    corner: Float64[np.ndarray, "_ d d"]

    @staticmethod
    def of(factor: Float64[np.ndarray, "b m"]) -> BandedFactor:
        """From a factor whose band i is i rows below the diagonal."""
        bands, size = factor.shape
        below, count = bands - 1, -(-size // _CHUNK)
        padded = np.zeros((bands, count * _CHUNK))
        padded[0] = 1.0
        padded[:, :size] = factor
        band = padded.reshape(bands, count, _CHUNK)
        column = np.arange(_CHUNK)
        block = np.zeros((count, _CHUNK, _CHUNK))
        corner = np.zeros((count - 1, below, below))
        for i in range(bands):
            here = _CHUNK - i
            block[:, column[i:], column[:here]] = band[i, :, :here]
            corner[:, column[:i], column[below - i : below]] = band[i, :-1, here:]
        return BandedFactor(np.linalg.inv(block), corner)

    def solve_half(
        self, right: Float64[np.ndarray, "m p"]
    ) -> Float64[np.ndarray, "m p"]:
        """L⁻¹ right."""
        solved = self.inverse @ self._cut(right)
        below = self.corner.shape[1]
        carry = self.inverse[1:, :, :below] @ self.corner
        for k, taken in enumerate(carry, start=1):
            solved[k] -= taken @ solved[k - 1, -below:]
        return self._join(solved, right)

    def solve(self, right: Float64[np.ndarray, "m p"]) -> Float64[np.ndarray, "m p"]:
        """(L Lᵀ)⁻¹ right."""
        turned = np.swapaxes(self.inverse, 1, 2)
        solved = turned @ self._cut(self.solve_half(right))
        below = self.corner.shape[1]
        carry = turned[:-1, :, -below:] @ np.swapaxes(self.corner, 1, 2)
        for k in range(len(carry) - 1, -1, -1):
            solved[k] -= carry[k] @ solved[k + 1, :below]
        return self._join(solved, right)

    def _cut(self, rows: Float64[np.ndarray, "m p"]) -> Float64[np.ndarray, "c k p"]:
        count = len(self.inverse)
        padded = np.pad(rows, ((0, count * _CHUNK - len(rows)), (0, 0)))
        return padded.reshape(count, _CHUNK, rows.shape[1])

    def _join(
        self, chunks: Float64[np.ndarray, "c k p"], like: Float64[np.ndarray, "m p"]
    ) -> Float64[np.ndarray, "m p"]:
        return chunks.reshape(len(chunks) * _CHUNK, like.shape[1])[: len(like)]
