"""How much better the Run is explained with an effect than without it.

The base, an elastic machine that any smooth error motion fits, is integrated out first:
what it can absorb is no evidence. An effect of k parameters with prior D then gains

    log B = ½ rᵀ (S + D⁻¹)⁻¹ r − ½ log det (I + D S),

S and r its information and data once the base has taken its share. The second term is
the price of freedom.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64
from scipy.linalg import solve_triangular

from app.discovery.sums import FoldedSums, Offered, information_of
from app.estimation.information import posterior
from app.kinematics.effects.catalogue import Candidate

_KNOWN = 100.0  # times the usual size: no prior to speak of


def prior_precision(
    base_precision: Float64[np.ndarray, "b b"], effects: Sequence[Candidate]
) -> Float64[np.ndarray, "p p"]:
    """Return the prior precision of base and known effects together.

    What is usual weighs whether an effect is there; how large it is, the data say.
    """
    usual = _KNOWN * np.concatenate([np.zeros(0), *(c.usual for c in effects)])
    size = len(base_precision)
    total = np.zeros((size + len(usual), size + len(usual)))
    total[:size, :size] = base_precision
    total[range(size, len(total)), range(size, len(total))] = usual**-2
    return total


@dataclass(frozen=True)
class Rest:
    """Information and data of each effect on offer, the known integrated out."""

    information: tuple[Float64[np.ndarray, "p p"], ...]
    data: tuple[Float64[np.ndarray, " p"], ...]

    def log_bayes(self, number: int, usual: Float64[np.ndarray, " p"]) -> float:
        """Return the gain in log evidence of one effect on offer."""
        return log_bayes(self.information[number], self.data[number], usual)


def log_bayes(
    S: Float64[np.ndarray, "p p"],
    r: Float64[np.ndarray, " p"],
    usual: Float64[np.ndarray, " p"],
) -> float:
    """Return log B of an effect from its information, data and prior."""
    scaled = np.eye(len(r)) + usual[:, None] * S * usual
    pulled = usual * r
    _, log_determinant = np.linalg.slogdet(scaled)
    gain = float(pulled @ np.linalg.solve(scaled, pulled))
    return 0.5 * gain - 0.5 * float(log_determinant)


def rest(offered: Offered, precision: Float64[np.ndarray, "p p"]) -> Rest:
    """Return what is left for the effects on offer.

    precision : prior of base and known effects
    """
    size = len(precision)
    scale = 1.0 / np.sqrt(np.diag(offered.known)[:size] + np.diag(precision))
    A = (offered.known[:size, :size] + precision) * scale[:, None] * scale
    factor = np.linalg.cholesky(A)
    known = _lower(factor, offered.known[:size, -1:] * scale[:, None])[:, 0]
    information: list[Float64[np.ndarray, "p p"]] = []
    data: list[Float64[np.ndarray, " p"]] = []
    for cross, own in zip(offered.cross, offered.own, strict=True):
        taken = _lower(factor, cross[:size] * scale[:, None])
        information.append(own - taken.T @ taken)
        data.append(cross[-1] - taken.T @ known)
    return Rest(tuple(information), tuple(data))


def _lower(
    factor: Float64[np.ndarray, "p p"], right: Float64[np.ndarray, "p q"]
) -> Float64[np.ndarray, "p q"]:
    return solve_triangular(factor, right, lower=True, check_finite=False)


@dataclass(frozen=True, slots=True)
class HeldOut:
    """How well lines are foretold that the fit did not see.

    square : (k,) squared misfit of each fold in units of the noise
    freedom : (k,) what noise alone would make it, on average
    unknown : (k,) what the fit's own uncertainty adds to that, on average
    fast_square, fast_freedom : (k,) of the samples within their cells; `square` has
        only what fast effects take from them
    """

    square: Float64[np.ndarray, " k"]
    freedom: Float64[np.ndarray, " k"]
    unknown: Float64[np.ndarray, " k"]
    fast_square: Float64[np.ndarray, " k"]
    fast_freedom: Float64[np.ndarray, " k"]

    def ratio(self, *, fast: bool = False) -> float:
        """Return the weighted root mean square misfit over that of noise.

        fast : of the samples within their cells as well
        """
        square, freedom = self.square.sum(), self.freedom.sum()
        if fast:
            square += self.fast_square.sum()
            freedom += self.fast_freedom.sum()
        return float(np.sqrt(square / freedom))

    def expected(self, *, fast: bool = False) -> float:
        """Return the ratio of a complete model: noise, and what the fit leaves open."""
        freedom = self.freedom.sum() + (self.fast_freedom.sum() if fast else 0.0)
        return float(np.sqrt(1.0 + self.unknown.sum() / freedom))


def held_out(
    sums: FoldedSums,
    columns: Int64[np.ndarray, " m"],
    precision: Float64[np.ndarray, "m m"],
) -> HeldOut:
    """Foretell each fold of lines from all others, with some of the columns."""
    total = sums.total()
    square, unknown = np.zeros((2, len(sums.fold)))
    for k, fold in enumerate(sums.fold):
        train = information_of(total - fold, columns)
        fit = posterior(train, precision)
        theta = fit.theta
        ask = fold[np.ix_(columns, columns)]
        square[k] = fold[-1, -1] - 2.0 * theta @ fold[columns, -1] + theta @ ask @ theta
        unknown[k] = float(np.sum(ask * fit.covariance))
    return HeldOut(square, sums.freedom, unknown, sums.fast_square, sums.fast_freedom)
