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
from scipy.linalg import cho_factor, cho_solve

from app.discovery.sums import FoldedSums, information_of
from app.estimation.information import posterior
from app.kinematics.effects.catalogue import Candidate

_KNOWN = 100.0  # times the usual size: no prior to speak of


@dataclass(frozen=True)
class Columns:
    """Where everything lies in the sums: base, chosen effects, effects on offer."""

    base: int
    chosen: tuple[Candidate, ...]
    offered: tuple[Candidate, ...]

    def of(self, number: int) -> Int64[np.ndarray, " m"]:
        """Return the columns of one effect, chosen ones counted first."""
        sizes = [len(c.usual) for c in (*self.chosen, *self.offered)]
        begin = self.base + sum(sizes[:number])
        return np.arange(begin, begin + sizes[number])

    @property
    def known(self) -> Int64[np.ndarray, " m"]:
        """Columns of base and chosen effects."""
        return np.arange(self.base + sum(len(c.usual) for c in self.chosen))


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
    """Information and data of the effects on offer, the known integrated out."""

    information: Float64[np.ndarray, "o o"]
    data: Float64[np.ndarray, " o"]
    slices: tuple[slice, ...]

    def log_bayes(self, number: int, usual: Float64[np.ndarray, " p"]) -> float:
        """Return the gain in log evidence of one effect on offer."""
        part = self.slices[number]
        return log_bayes(self.information[part, part], self.data[part], usual)

    def likeness(self, one: int, other: int) -> float:
        """Return the share of one effect's signal that another would take away."""
        a, b = self.slices[one], self.slices[other]
        A, B = self.information[a, a], self.information[b, b]
        cross = self.information[a, b]
        theta = np.linalg.lstsq(A, self.data[a], rcond=1e-10)[0]
        signal = float(theta @ A @ theta)
        pulled = cross.T @ theta
        taken = float(pulled @ np.linalg.lstsq(B, pulled, rcond=1e-10)[0])
        return taken / max(signal, 1e-300)


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


def rest(
    total: Float64[np.ndarray, "q q"],
    columns: Columns,
    precision: Float64[np.ndarray, "p p"],
) -> Rest:
    """Return what is left for the effects on offer.

    precision : prior of base and chosen effects
    """
    known = columns.known
    begin = len(known)
    scale = 1.0 / np.sqrt(np.diag(total)[:begin] + np.diag(precision))
    A = (total[:begin, :begin] + precision) * scale[:, None] * scale
    factor = cho_factor(A, lower=True)
    cross = total[:begin, begin:] * scale[:, None]
    left = total[begin:, begin:] - cross.T @ cho_solve(factor, cross)
    first = len(columns.chosen)
    slices: list[slice] = []
    for number in range(len(columns.offered)):
        at = columns.of(first + number)
        slices.append(slice(int(at[0]) - begin, int(at[-1]) + 1 - begin))
    return Rest(left[:-1, :-1], left[:-1, -1], tuple(slices))


@dataclass(frozen=True, slots=True)
class HeldOut:
    """How well lines are foretold that the fit did not see.

    square : (k,) squared misfit of each fold in units of the noise
    freedom : (k,) what noise alone would make it, on average
    fast_square, fast_freedom : (k,) of the samples within their cells; `square` has
        only what fast effects take from them
    """

    square: Float64[np.ndarray, " k"]
    freedom: Float64[np.ndarray, " k"]
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


def held_out(
    sums: FoldedSums,
    columns: Int64[np.ndarray, " m"],
    precision: Float64[np.ndarray, "m m"],
) -> HeldOut:
    """Foretell each fold of lines from all others, with some of the columns."""
    total = sums.total()
    square = np.zeros(len(sums.fold))
    for k, fold in enumerate(sums.fold):
        train = information_of(total - fold, columns)
        theta = posterior(train, precision).theta
        ask = fold[np.ix_(columns, columns)]
        square[k] = fold[-1, -1] - 2.0 * theta @ fold[columns, -1] + theta @ ask @ theta
    return HeldOut(square, sums.freedom, sums.fast_square, sums.fast_freedom)
