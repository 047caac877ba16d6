"""All data that terms are fitted to, and the log Bayes factors of terms on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.discovery.evidence import Remainder, integrate_out, prior_precision
from app.estimation.term_equations import Lines
from app.kinematics.conditions import Conditions
from app.kinematics.effects.candidate_term import CandidateTerm


@dataclass(frozen=True)
class ValueTrials:
    """Log Bayes factors of a term at several values, with its parameters there."""

    values: Float64[np.ndarray, " v"]
    log_bayes: Float64[np.ndarray, " v"]
    theta: Float64[np.ndarray, "v p"]
    covariance: Float64[np.ndarray, "v p p"]


@dataclass(frozen=True)
class TermData:
    """The lines of all Runs, and what is known of machine and poses.

    at : conditions of each Run; precision : (b, b) prior of machine and poses
    """

    lines: Lines
    at: tuple[Conditions, ...]
    precision: Float64[np.ndarray, "b b"]

    def conditions_of(self, term: CandidateTerm) -> Conditions:
        """Return the conditions of the Run that a term is scanned in."""
        return self.at[term.run or 0]

    def compare(
        self, beside: Sequence[CandidateTerm], terms: Sequence[CandidateTerm]
    ) -> Remainder:
        """Return what the data tell of each term.

        beside : terms that are integrated out with machine and poses
        """
        blocks = self.lines.collect_blocks(
            [t.effect for t in beside], [t.effect for t in terms]
        )
        return integrate_out(blocks, prior_precision(self.precision, beside), terms)

    def try_values(
        self,
        beside: Sequence[CandidateTerm],
        term: CandidateTerm,
        values: Float64[np.ndarray, " v"],
    ) -> ValueTrials:
        """Return what the data tell of a term at each of several values."""
        terms = [term.with_value(float(value)) for value in values]
        remainder = self.compare(beside, terms)
        known = prior_precision(np.zeros((0, 0)), [term])
        covariance = np.linalg.inv(np.array(remainder.information) + known)
        theta = np.einsum("vpq,vq->vp", covariance, np.array(remainder.data))
        return ValueTrials(values, remainder.log_bayes(), theta, covariance)
