"""What one more measurement is worth, and where on one axis it is worth most.

A belief has a covariance C of control values; its quality is the integrated variance
J = tr(G C), G the Gram matrix of the splines (brunn-hanebeck-2005, eq. 24–26, 34–36).
One scalar measurement with row h and noise variance σ² lowers J by

    hᵀ C G C h / (σ² + hᵀ C h).

Between two neighbouring knots of an axis h is a cubic of the position, whatever other
axes add, so this is a ratio of sextics, and the best place is an end of the interval or
a root of its derivative: a polynomial of tenth order (eq. 27).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy.polynomial import polynomial

Rows = Callable[[Float64[np.ndarray, " n"]], Float64[np.ndarray, "n p"]]

_NEGLIGIBLE = 1e-14  # a coefficient relative to the largest: rounding, no term
# Cubic coefficients from values at four places of the unit interval.
_PLACES = np.array([0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0])
_FROM_VALUES = np.linalg.inv(np.vander(_PLACES, 4, increasing=True))


@dataclass(frozen=True, slots=True)
class Belief:
    """How well control values are known: covariance C and Gram matrix G."""

    covariance: Float64[np.ndarray, "p p"]
    gram: Float64[np.ndarray, "p p"]

    @property
    def integrated_variance(self) -> float:
        """J = tr(G C)."""
        return float(np.sum(self.gram * self.covariance))

    def drops(
        self, rows: Float64[np.ndarray, "n p"], noise_variance: float
    ) -> Float64[np.ndarray, " n"]:
        """Return by how much J falls for each row, measured alone."""
        moved = rows @ self.covariance
        gained = np.einsum("np,np->n", moved @ self.gram, moved)
        return gained / (noise_variance + np.einsum("np,np->n", moved, rows))

    def after(self, row: Float64[np.ndarray, " p"], noise_variance: float) -> Belief:
        """Return what is known after one scalar measurement (eq. 22–23, 32–33)."""
        gain = self.covariance @ row / (noise_variance + row @ self.covariance @ row)
        left = np.eye(len(row)) - np.outer(gain, row)
        covariance = left @ self.covariance @ left.T
        covariance += noise_variance * np.outer(gain, gain)
        return Belief((covariance + covariance.T) / 2.0, self.gram)


@dataclass(frozen=True, slots=True)
class BestPlace:
    """The place on an axis where one measurement lowers J most, and by how much."""

    at: float
    drop: float


def best_place(
    known: Belief,
    rows: Rows,
    borders: Float64[np.ndarray, " b"],
    noise_variance: float,
) -> BestPlace:
    """Return the exact optimum over an axis (eq. 27).

    rows : measurement rows at places of the axis, cubic between neighbouring borders
    borders : increasing; the ends of the axis and every knot between them
    """
    low, length = borders[:-1], np.diff(borders)
    samples = low[:, None] + _PLACES * length[:, None]
    values = rows(samples.ravel()).reshape(len(low), len(_PLACES), -1)
    weight = known.covariance @ known.gram @ known.covariance
    places = [borders]
    for begin, span, cubic in zip(low, length, _FROM_VALUES @ values, strict=True):
        gained = _quadratic_form(cubic, weight)
        spread = _quadratic_form(cubic, known.covariance)
        spread[0] += noise_variance
        places.append(begin + span * _stationary(gained, spread))
    candidates = np.concatenate(places)
    drops = known.drops(rows(candidates), noise_variance)
    best = int(np.argmax(drops))
    return BestPlace(float(candidates[best]), float(drops[best]))


def _quadratic_form(
    cubic: Float64[np.ndarray, "4 p"], matrix: Float64[np.ndarray, "p p"]
) -> Float64[np.ndarray, "7"]:
    """Return the coefficients of h(u)ᵀ M h(u), a sextic, lowest first."""
    products = cubic @ matrix @ cubic.T
    return np.array([np.trace(products[::-1], offset=k) for k in range(-3, 4)])


def _stationary(
    above: Float64[np.ndarray, "7"], below: Float64[np.ndarray, "7"]
) -> Float64[np.ndarray, " r"]:
    """Return the places in the unit interval where above / below may be stationary.

    Real parts of all roots, complex ones too: a double root splits into a pair by
    rounding, and a place too many costs nothing, as the best is chosen by its value.
    """
    slope = polynomial.polysub(
        polynomial.polymul(polynomial.polyder(above), below),
        polynomial.polymul(above, polynomial.polyder(below)),
    )[:11]  # the terms of eleventh order cancel
    known = np.flatnonzero(np.abs(slope) > _NEGLIGIBLE * np.abs(slope).max())
    if not len(known):
        return np.empty(0)
    roots = np.real(polynomial.polyroots(slope[: known[-1] + 1]))
    return roots[(roots > 0.0) & (roots < 1.0)]
