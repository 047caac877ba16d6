"""What is stated of each effect that was found: numbers, evidence, alternatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.discovery.term_fitter import TermFit, TermFitter
from app.discovery.term_search import EQUIVALENT
from app.kinematics.effects.candidate_term import CandidateTerm
from app.kinematics.effects.catalogue import (
    Candidate,
    CandidateEstimate,
    Family,
    Quantity,
)


@dataclass(frozen=True)
class Evidence:
    """Why an effect is believed.

    log_bayes : of the effect given the others, less the cost of the search
    held_out : gain in log score on lines that were held out of the fit
    share : of the gap that it closes
    """

    log_bayes: float
    held_out: float
    share: float


@dataclass(frozen=True)
class Finding:
    """One effect with its parameters, its evidence, and what else it may be.

    rivals : terms that would explain the Runs as well
    """

    term: CandidateTerm
    parameters: dict[str, Quantity]
    theta: Float64[np.ndarray, " p"]
    covariance: Float64[np.ndarray, "p p"]
    evidence: Evidence
    rivals: tuple[CandidateTerm, ...]

    @property
    def alternatives(self) -> tuple[Candidate, ...]:
        """Other effects that explain the Runs as well."""
        return tuple(rival.candidate for rival in self.rivals)

    @property
    def family(self) -> Family:
        """The effect's family."""
        return self.term.family

    @property
    def candidate(self) -> Candidate:
        """The effect."""
        return self.term.candidate

    @property
    def structure(self) -> Family | None:
        """Its family, if it is structure without a catalogued cause."""
        return None if self.family.names_cause else self.family


def state_findings(
    fitter: TermFitter, baseline: TermFit, best: TermFit
) -> tuple[Finding, ...]:
    """Return what is stated of the terms of a fit, by evidence, greatest first.

    baseline : the fit without terms
    """
    found = [_state(fitter, baseline, best, k) for k in range(len(best.terms))]
    return tuple(sorted(found, key=lambda f: -f.evidence.log_bayes))


def _state(
    fitter: TermFitter, baseline: TermFit, best: TermFit, number: int
) -> Finding:
    term = best.terms[number]
    without = fitter.fit(best.other_terms(term))
    log_bayes = fitter.rank(without, [term])[0].evidence
    theta, covariance = best.parameters_of(number)
    if term.covariance is not None:
        covariance = term.covariance
    return Finding(
        term,
        term.family.state(
            CandidateEstimate(term.candidate, theta, covariance, term.value_sigma)
        ),
        theta,
        covariance,
        _evidence(log_bayes, baseline.misfit, without.misfit, best.misfit),
        _rivals(fitter, without, term, log_bayes),
    )


def _evidence(
    log_bayes: float, baseline: float, without: float, best: float
) -> Evidence:
    """Return the evidence from the misfit of held-out lines in each of three fits."""
    lost = without - best
    return Evidence(log_bayes, 0.5 * lost, lost / max(baseline - best, 1e-12))


def _rivals(
    fitter: TermFitter, without: TermFit, term: CandidateTerm, evidence: float
) -> tuple[CandidateTerm, ...]:
    """Return the terms with a cause that would explain the Runs as well."""
    return tuple(
        r.term
        for r in fitter.rank_catalogue(without)
        if r.term.label != term.label
        and r.evidence > evidence - EQUIVALENT
        and r.term.has_cause
    )
