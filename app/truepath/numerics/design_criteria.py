"""Value of one more measurement, and the position on an axis where it is largest.

Control values have a covariance C; its quality is the integrated variance J = tr(G C),
G the Gram matrix of the splines (brunn-hanebeck-2005, eq. 24–26, 34–36). A measurement
of r values at once, with rows H and noise variance σ² each, lowers J by

    f = tr(S⁻¹ M),    S = σ² I + H C Hᵀ,    M = H C G C Hᵀ,

for one value hᵀ C G C h / (σ² + hᵀ C h). Between two neighbouring knots of an axis H is
a polynomial of the position, a cubic where the axis is straight, whatever other axes
add. So f = N / D, D = det S, is a ratio of polynomials (sextics for one value), and the
maximum is at an end of the interval or a root of N'D − N D', of tenth order for one
value (eq. 27).

Monomial coefficients of that order lose their digits, which is where the paper suspects
its own numbers. Here a polynomial is its values at Chebyshev nodes of its interval, and
roots are eigenvalues of the colleague matrix of its Chebyshev series. Most intervals
need none: by Ehlich and Zeller (1964) a polynomial of degree m, known at 4m nodes, goes
beyond the range of those values by no more than the factor 1 / cos(π/8), which rules an
interval out whose N − f* D stays below 0, f* being the best node of all.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float64, Int64
from numpy.polynomial import chebyshev

Rows = Callable[[Float64[np.ndarray, " n"]], Float64[np.ndarray, "n *r p"]]

_NEGLIGIBLE = 1e-15  # a coefficient relative to the largest: rounding, no term
_DENSER = 4  # nodes per order of a polynomial whose range they bound
_BEYOND = 1.0 / np.cos(np.pi / (2 * _DENSER))


@dataclass(frozen=True, slots=True)
class IntegratedVariance:
    """Covariance C of control values, and the Gram matrix G."""

    covariance: Float64[np.ndarray, "p p"]
    gram: Float64[np.ndarray, "p p"]

    @property
    def integrated_variance(self) -> float:
        return float(np.sum(self.gram * self.covariance))

    def compute_drops(
        self, rows: Float64[np.ndarray, "n *r p"], noise_variance: float = 1.0
    ) -> Float64[np.ndarray, " n"]:
        """Reduction of J by each measurement alone.

        rows : (n, p), or (n, r, p) for r values at once
        noise_variance : of each value; 1 for rows in units of their noise
        """
        flat = rows.reshape(-1, rows.shape[-1])
        moved = flat @ self.covariance
        gained = moved @ self.gram
        if rows.ndim == 2:
            drop = np.einsum("np,np->n", gained, moved)
            return drop / (noise_variance + np.einsum("np,np->n", moved, rows))
        moved, gained = moved.reshape(rows.shape), gained.reshape(rows.shape)
        spread = moved @ np.swapaxes(rows, 1, 2)
        spread += noise_variance * np.eye(rows.shape[1])
        return _traces(spread, gained @ np.swapaxes(moved, 1, 2))

    def update(
        self, rows: Float64[np.ndarray, "*r p"], noise_variance: float = 1.0
    ) -> IntegratedVariance:
        """Covariance after one measurement (eq. 22–23, 32–33).

        rows : (p,), or (r, p) for r values at once
        """
        H = rows.reshape(-1, rows.shape[-1])
        noise = noise_variance * np.eye(len(H))
        gain = np.linalg.solve(H @ self.covariance @ H.T + noise, H @ self.covariance).T
        left = np.eye(H.shape[1]) - gain @ H
        covariance = left @ self.covariance @ left.T
        covariance += noise_variance * (gain @ gain.T)
        return IntegratedVariance((covariance + covariance.T) / 2.0, self.gram)


@dataclass(frozen=True, slots=True)
class BestPosition:
    """Position on an axis where one measurement reduces J most, and by how much."""

    at: float
    drop: float


def find_best_position(
    known: IntegratedVariance,
    rows: Rows,
    borders: Float64[np.ndarray, " b"],
    noise_variance: float,
    *,
    degree: int = 3,
) -> BestPosition:
    """Exact optimum over an axis (eq. 27).

    rows : at positions of the axis, (n, p) or (n, r, p), polynomials of the given
        degree between neighbouring borders
    borders : increasing; the ends of the axis and every knot between them
    """
    pieces = _pieces(known, rows, borders, noise_variance, degree)
    order = 2 * degree * pieces.values
    nodes = _dense_nodes(_DENSER * order)
    spread, gained = pieces.at(_dense_products(degree + 1, _DENSER * order))
    drops = _traces(spread, gained)
    piece, node = np.unravel_index(int(np.argmax(drops)), drops.shape)
    found = [(float(drops[piece, node]), int(piece), float(nodes[node]))]
    for index in _worth_solving(drops, spread):
        # A position too many costs nothing: the best is chosen by its value.
        roots = _roots(pieces.slopes(int(index), 2 * order - 1, degree))
        values, _ = _products(degree + 1, roots)
        risen = _traces(*pieces.at(values, np.array([index])))[0]
        found += zip(risen.tolist(), [int(index)] * len(roots), roots, strict=True)
    drop, piece, unit = max(found)
    at = pieces.low[piece] + 0.5 * (unit + 1.0) * pieces.length[piece]
    return BestPosition(float(at), drop)


@dataclass(frozen=True, slots=True)
class _Pieces:
    """S and M of every interval, as quadratic forms of rows at d + 1 nodes.

    spread, gained : (i, r, r, (d + 1)²), rows scaled so that their noise is 1
    """

    low: Float64[np.ndarray, " i"]
    length: Float64[np.ndarray, " i"]
    spread: Float64[np.ndarray, "i r r kk"]
    gained: Float64[np.ndarray, "i r r kk"]

    @property
    def values(self) -> int:
        return self.spread.shape[1]

    def at(
        self,
        products: Float64[np.ndarray, "kk n"],
        intervals: Int64[np.ndarray, " i"] | slice = slice(None),
    ) -> tuple[Float64[np.ndarray, "i n r r"], Float64[np.ndarray, "i n r r"]]:
        noise = np.eye(self.values)
        spread = _forms(self.spread[intervals], products) + noise
        return spread, _forms(self.gained[intervals], products)

    def slopes(self, index: int, count: int, degree: int) -> Float64[np.ndarray, " n"]:
        """D² f', a polynomial, at Chebyshev's nodes of an interval."""
        values, slopes = _node_products(degree + 1, count)
        spread, gained = self.spread[[index]], self.gained[[index]]
        S = _forms(spread, values)[0] + np.eye(self.values)
        M, dS, dM = (
            _forms(form, products)[0]
            for form, products in ((gained, values), (spread, slopes), (gained, slopes))
        )
        if self.values == 1:
            return (dM * S - M * dS)[:, 0, 0]
        solved = np.asarray(np.linalg.solve(S, M), np.float64)
        slope = _traces(S, dM - dS @ solved)
        D = np.linalg.det(S)
        return slope * (D / D.max()) ** 2


def _pieces(
    known: IntegratedVariance,
    rows: Rows,
    borders: Float64[np.ndarray, " b"],
    noise_variance: float,
    degree: int,
) -> _Pieces:
    low, length = borders[:-1], np.diff(borders)
    nodes = _nodes(degree + 1)
    places = low[:, None] + 0.5 * (nodes + 1.0) * length[:, None]
    found = rows(places.ravel())
    p = found.shape[-1]
    r = found.size // (len(found) * p)
    # Noise first scaled to 1: a determinant of many small numbers would vanish.
    H = found.reshape(-1, p) / np.sqrt(noise_variance)
    moved = H @ known.covariance
    shape = (len(low), degree + 1, r, degree + 1, r)
    flat = (len(low), -1, p)
    spread = moved.reshape(flat) @ np.swapaxes(H.reshape(flat), 1, 2)
    gained = (moved @ known.gram).reshape(flat) @ np.swapaxes(moved.reshape(flat), 1, 2)
    spread, gained = (
        form.reshape(shape).transpose(0, 2, 4, 1, 3).reshape(len(low), r, r, -1)
        for form in (spread, gained)
    )
    return _Pieces(low, length, spread, gained)


def _forms(
    forms: Float64[np.ndarray, "i r r kk"], products: Float64[np.ndarray, "kk n"]
) -> Float64[np.ndarray, "i n r r"]:
    return (forms @ products).transpose(0, 3, 1, 2)


def _worth_solving(
    drops: Float64[np.ndarray, "i n"], spread: Float64[np.ndarray, "i n r r"]
) -> Int64[np.ndarray, " s"]:
    """Intervals in which f may exceed the best of all nodes."""
    D = spread[..., 0, 0] if spread.shape[-1] == 1 else np.linalg.det(spread)
    beyond = (drops - drops.max()) * D
    middle = 0.5 * (beyond.max(axis=1) + beyond.min(axis=1))
    half = 0.5 * np.ptp(beyond, axis=1)
    return np.flatnonzero(middle + _BEYOND * half >= 0.0)


def _traces(
    spread: Float64[np.ndarray, "*n r r"], gained: Float64[np.ndarray, "*n r r"]
) -> Float64[np.ndarray, "*n"]:
    """tr(S⁻¹ M)."""
    if spread.shape[-1] == 1:
        return gained[..., 0, 0] / spread[..., 0, 0]
    return np.trace(np.linalg.solve(spread, gained), axis1=-2, axis2=-1)


def _roots(values: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " r"]:
    """Roots inside [−1, 1] of a polynomial given at nodes.

    Real parts of complex ones too: a double root splits into a pair by rounding.
    """
    series = _series_map(len(values)) @ values
    known = np.flatnonzero(np.abs(series) > _NEGLIGIBLE * np.abs(series).max())
    if not len(known) or known[-1] == 0:
        return np.empty(0)
    roots = np.real(chebyshev.chebroots(series[: known[-1] + 1]))
    return roots[np.abs(roots) <= 1.0]


@lru_cache
def _nodes(count: int) -> Float64[np.ndarray, " n"]:
    return np.cos(np.pi * (np.arange(count) + 0.5) / count)


@lru_cache
def _series_map(count: int) -> Float64[np.ndarray, "n n"]:
    waves = np.cos(np.pi * np.outer(np.arange(count), np.arange(count) + 0.5) / count)
    waves[0] *= 0.5
    return 2.0 / count * waves


def _products(
    size: int, at: Float64[np.ndarray, " n"]
) -> tuple[Float64[np.ndarray, "kk n"], Float64[np.ndarray, "kk n"]]:
    """Products of Lagrange's polynomials over `size` nodes, and their slopes.

    A quadratic form of a polynomial's values at the nodes is linear in them.
    """
    series = _series_map(size)
    values = chebyshev.chebvander(at, size - 1) @ series
    slopes = chebyshev.chebvander(at, size - 2) @ chebyshev.chebder(series)
    product = values[:, :, None] * values[:, None, :]
    slope = slopes[:, :, None] * values[:, None, :]
    slope = slope + np.swapaxes(slope, 1, 2)
    return product.reshape(len(at), size**2).T, slope.reshape(len(at), size**2).T


@lru_cache
def _node_products(
    size: int, count: int
) -> tuple[Float64[np.ndarray, "kk n"], Float64[np.ndarray, "kk n"]]:
    return _products(size, _nodes(count))


@lru_cache
def _dense_nodes(count: int) -> Float64[np.ndarray, " n"]:
    return np.concatenate([[-1.0], _nodes(count), [1.0]])


@lru_cache
def _dense_products(size: int, count: int) -> Float64[np.ndarray, "kk n"]:
    products, _ = _products(size, _dense_nodes(count))
    return products
