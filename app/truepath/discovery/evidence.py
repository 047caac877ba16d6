"""The evidence for a term, and the prediction error of held-out lines.

The machine, which any smooth error motion fits, is integrated out first: a displacement
that it can absorb is no evidence. A term of k parameters with prior covariance D then
has the log Bayes factor

    log B = ½ rᵀ (S + D⁻¹)⁻¹ r − ½ log det (I + D S),

S and r its information and data once the machine has taken its share. The second part
penalises free parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.linalg import solve_triangular

from truepath.discovery.term_equations import (
    CandidateBlocks,
    FoldedSums,
    TermEquations,
)
from truepath.estimation.problem.information import Information, compute_posterior
from truepath.kinematics.conditions import Conditions
from truepath.kinematics.effects.family import CandidateTerm

_FREE = 100.0  # times the typical size: a fitted term has hardly a prior


def prior_precision(
    base: Float64[np.ndarray, "b b"], terms: Sequence[CandidateTerm]
) -> Float64[np.ndarray, "p p"]:
    """Prior precision of machine, poses and fitted terms together.

    The typical size matters for the existence of a term only; fitted, it has a hundred
    times this size as a prior.
    """
    typical = _FREE * np.concatenate(
        [np.zeros(0), *(t.candidate.prior_sigma for t in terms)]
    )
    size = len(base)
    total = np.zeros((size + len(typical), size + len(typical)))
    total[:size, :size] = base
    total[range(size, len(total)), range(size, len(total))] = typical**-2
    return total


@dataclass(frozen=True)
class Remainder:
    """Information and data of each term, all other parameters integrated out."""

    terms: tuple[CandidateTerm, ...]
    information: tuple[Float64[np.ndarray, "p p"], ...]
    data: tuple[Float64[np.ndarray, " p"], ...]

    def log_bayes(self) -> Float64[np.ndarray, " t"]:
        """One for each term, without the cost of the search."""
        each = zip(self.information, self.data, self.terms, strict=True)
        return np.array(
            [log_bayes(S, r, term.candidate.prior_sigma) for S, r, term in each]
        )


def log_bayes(
    S: Float64[np.ndarray, "p p"],
    r: Float64[np.ndarray, " p"],
    typical: Float64[np.ndarray, " p"],
) -> float:
    """Log B of a term from its information, data and typical size."""
    scaled = np.eye(len(r)) + typical[:, None] * S * typical
    pull = typical * r
    _, log_determinant = np.linalg.slogdet(scaled)
    gain = float(pull @ np.linalg.solve(scaled, pull))
    return 0.5 * gain - 0.5 * float(log_determinant)


def integrate_out(
    blocks: CandidateBlocks,
    precision: Float64[np.ndarray, "p p"],
    terms: Sequence[CandidateTerm],
) -> Remainder:
    """Information and data of each term once all other parameters are integrated out.

    blocks : normal equations of each term with the other parameters
    precision : prior of the other parameters
    """
    size = len(precision)
    scale = 1.0 / np.sqrt(np.diag(blocks.known)[:size] + np.diag(precision))
    A = (blocks.known[:size, :size] + precision) * scale[:, None] * scale
    factor = np.linalg.cholesky(A)
    known = _solve_lower(factor, blocks.known[:size, -1:] * scale[:, None])[:, 0]
    information: list[Float64[np.ndarray, "p p"]] = []
    data: list[Float64[np.ndarray, " p"]] = []
    for cross, own in zip(blocks.cross, blocks.own, strict=True):
        absorbed = _solve_lower(factor, cross[:size] * scale[:, None])
        information.append(own - absorbed.T @ absorbed)
        data.append(cross[-1] - absorbed.T @ known)
    return Remainder(tuple(terms), tuple(information), tuple(data))


def _solve_lower(
    factor: Float64[np.ndarray, "p p"], right: Float64[np.ndarray, "p q"]
) -> Float64[np.ndarray, "p q"]:
    return solve_triangular(factor, right, lower=True, check_finite=False)


@dataclass(frozen=True, slots=True)
class HeldOutMisfit:
    """Prediction error of lines that were held out of the fit.

    square : (k,) squared misfit of each fold in units of the noise
    freedom : (k,) its expectation from noise alone
    unknown : (k,) addition to that expectation by the uncertainty of the fit
    fast_square, fast_freedom : (k,) of the samples within their cells; `square` has
        only the part that fast effects take from them
    """

    square: Float64[np.ndarray, " k"]
    freedom: Float64[np.ndarray, " k"]
    unknown: Float64[np.ndarray, " k"]
    fast_square: Float64[np.ndarray, " k"]
    fast_freedom: Float64[np.ndarray, " k"]

    def measure_ratio(self, *, fast: bool = False) -> float:
        """Weighted root mean square misfit over that of noise.

        fast : include the samples within their cells
        """
        square = self.square.sum() + (self.fast_square.sum() if fast else 0.0)
        return float(np.sqrt(square / self._total_freedom(fast)))

    def expect_ratio(self, *, fast: bool = False) -> float:
        """Ratio expected of a complete model: noise and the fit's uncertainty."""
        return float(np.sqrt(1.0 + self.unknown.sum() / self._total_freedom(fast)))

    def measure_excess(self, *, fast: bool = False) -> float:
        """Squared misfit beyond that of noise, in units of the noise."""
        ratio = self.measure_ratio(fast=fast)
        return (ratio**2 - 1.0) * self._total_freedom(fast)

    def _total_freedom(self, fast: bool) -> float:
        return self.freedom.sum() + (self.fast_freedom.sum() if fast else 0.0)


def predict_held_out(
    sums: FoldedSums, precision: Float64[np.ndarray, "m m"]
) -> HeldOutMisfit:
    """Cross-validation: each fold of lines is predicted from all others."""
    total, columns = sums.total, np.arange(len(precision))
    square, unknown = np.zeros((2, len(sums.fold)))
    for k, fold in enumerate(sums.fold):
        fit = compute_posterior(
            Information.from_total(total - fold, columns=columns), precision
        )
        theta = fit.theta
        own = fold[:-1, :-1]
        square[k] = fold[-1, -1] - 2.0 * theta @ fold[:-1, -1] + theta @ own @ theta
        unknown[k] = float(np.sum(own * fit.covariance))
    return HeldOutMisfit(
        square, sums.freedom, unknown, sums.fast_square, sums.fast_freedom
    )


@dataclass(frozen=True)
class ValueTrials:
    """Log Bayes factors of a term at several values, with its parameters there."""

    values: Float64[np.ndarray, " v"]
    log_bayes: Float64[np.ndarray, " v"]
    theta: Float64[np.ndarray, "v p"]
    covariance: Float64[np.ndarray, "v p p"]


@dataclass(frozen=True)
class TermData:
    """The lines of all Runs, and the prior of machine and poses.

    precision : (b, b) of that prior
    """

    equations: TermEquations
    precision: Float64[np.ndarray, "b b"]

    def conditions_of(self, term: CandidateTerm) -> Conditions:
        """Of the Run that a term is scanned in; the first Run for terms of all Runs."""
        return self.equations.lines.runs[term.run or 0].observations.at

    def compare(
        self,
        given: Sequence[CandidateTerm],
        terms: Sequence[CandidateTerm],
        *,
        keep: bool = True,
    ) -> Remainder:
        """Information and data of each term.

        given : terms that are integrated out with machine and poses
        keep : cache the terms' columns
        """
        blocks = self.equations.collect_blocks(
            [t.effect for t in given], [t.effect for t in terms], keep=keep
        )
        return integrate_out(blocks, prior_precision(self.precision, given), terms)

    def compare_moments(
        self,
        given: Sequence[CandidateTerm],
        term: CandidateTerm,
        moment_s: Float64[np.ndarray, " v"],
    ) -> Remainder:
        """Information and data of a one-time term at several moments.

        moment_s : increasing
        """
        terms = [term.with_value(float(t)) for t in moment_s]
        blocks = self.equations.collect_blocks_of_moments(
            [t.effect for t in given], [t.effect for t in terms], moment_s
        )
        return integrate_out(blocks, prior_precision(self.precision, given), terms)

    def try_values(
        self,
        given: Sequence[CandidateTerm],
        term: CandidateTerm,
        values: Float64[np.ndarray, " v"],
    ) -> ValueTrials:
        terms = [term.with_value(float(value)) for value in values]
        remainder = self.compare(given, terms, keep=False)
        known = prior_precision(np.zeros((0, 0)), [term])
        covariance = np.linalg.inv(np.array(remainder.information) + known)
        theta = np.einsum("vpq,vq->vp", covariance, np.array(remainder.data))
        return ValueTrials(values, remainder.log_bayes(), theta, covariance)
