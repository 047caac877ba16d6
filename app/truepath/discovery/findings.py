"""Results for each effect found, and for the gap on held-out lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from truepath.discovery.line_blocks import RunData
from truepath.discovery.name_trial import TriedNames
from truepath.discovery.term_search import TermFit, TermFitter
from truepath.estimation.problem.noise import expected_rms_mm
from truepath.kinematics.effects.family import (
    Candidate,
    CandidateEstimate,
    CandidateTerm,
    Family,
    Quantity,
)

_LEAST_MM = 5e-4  # half of what most controls correct by


@dataclass(frozen=True)
class Evidence:
    """The evidence of an effect.

    log_bayes : of the effect given the others, less the cost of the search
    held_out : gain in log score on lines that were held out of the fit
    share : of the gap above a complete model's that it closes, at most 1
    """

    log_bayes: float
    held_out: float
    share: float


@dataclass(frozen=True)
class Finding:
    """One effect with its parameters, its evidence, and alternative explanations.

    rivals : terms that would explain the Runs as well
    is_imitated : the tracker could produce it if it exceeds its specification
    largest_mm : displacement of the target over the whole measurement
    grade : `certain`, `likely`, or `possible` where free forms do as well
    """

    term: CandidateTerm
    parameters: dict[str, Quantity]
    theta: Float64[np.ndarray, " p"]
    covariance: Float64[np.ndarray, "p p"]
    evidence: Evidence
    rivals: tuple[CandidateTerm, ...]
    grade: str
    largest_mm: float
    is_imitated: bool = False

    @property
    def is_small(self) -> bool:
        """Whether it moves the target by less than a control corrects."""
        return self.largest_mm < _LEAST_MM

    @property
    def alternatives(self) -> tuple[Candidate, ...]:
        return tuple(rival.candidate for rival in self.rivals)

    @property
    def family(self) -> Family:
        return self.term.family

    @property
    def candidate(self) -> Candidate:
        return self.term.candidate

    @property
    def structure(self) -> Family | None:
        """Its family, if it is structure without a catalogued cause."""
        return None if self.family.names_cause else self.family


def state_findings(
    fitter: TermFitter, baseline: TermFit, tried: TriedNames
) -> tuple[Finding, ...]:
    """Results for the accepted terms, greatest evidence first.

    baseline : the fit without terms
    """
    count = range(len(tried.fit.terms))
    found = [_state(fitter, baseline, tried.fit, tried, k) for k in count]
    return tuple(sorted(found, key=lambda f: -f.evidence.log_bayes))


def state_possible(
    fitter: TermFitter, baseline: TermFit, tried: TriedNames
) -> tuple[Finding, ...]:
    terms = tried.named.terms
    return tuple(
        _state(fitter, baseline, tried.named, tried, k)
        for k in range(len(terms))
        if terms[k] in tried.doubtful
    )


def _state(
    fitter: TermFitter,
    baseline: TermFit,
    best: TermFit,
    tried: TriedNames,
    number: int,
) -> Finding:
    term = best.terms[number]
    without = fitter.fit(best.other_terms(term), refine=False)
    log_bayes = fitter.rank(without, [term])[0].evidence
    theta, covariance = best.parameters_of(number)
    if term.covariance is not None:
        covariance = term.covariance
    lost = without.misfit - best.misfit
    rivals = fitter.find_rivals(without, term, log_bayes)
    return Finding(
        term,
        term.family.state(
            CandidateEstimate(term.candidate, theta, covariance, term.value_sigma)
        ),
        theta,
        covariance,
        Evidence(log_bayes, 0.5 * lost, compute_share(lost, baseline, best)),
        rivals,
        tried.grade(term, log_bayes, rivals),
        max(_find_largest_mm(term, theta, data) for data in fitter.run_data),
        tried.is_imitated(term) or term.family.tracker_may_imitate,
    )


def _find_largest_mm(
    term: CandidateTerm, theta: Float64[np.ndarray, " p"], data: RunData
) -> float:
    at = data.observations.at
    if at.recorded is not None:
        # Within a cell and right after a reversal it is more than the cell's mean.
        since = at.recorded.since_reversal
        recorded = replace(
            at.recorded,
            span_s=0.0 * at.recorded.span_s,
            since_reversal=np.where(np.isfinite(since), 0.0, since),
        )
        at = replace(at, recorded=recorded)
    begin_s = float(at.time_s[0])
    columns = term.effect.jacobian_in_time(np.linspace(begin_s, begin_s + 1.0, 2000))
    if columns is None:
        columns = term.effect.jacobian(at)
    return float(np.linalg.norm(columns @ theta, axis=1).max())


def compute_share(lost: float, baseline: TermFit, best: TermFit) -> float:
    """Share of the misfit above a complete model's that a term removes.

    The remaining gap counts: a lone effect closes all of the gap only where nothing but
    noise remains.
    """
    fast = best.has_fast
    before = baseline.held_out.measure_excess(fast=fast)
    departure = baseline.misfit - float(baseline.held_out.square.sum())
    uncertain = float(best.held_out.unknown.sum())
    gap = max(before + departure - uncertain, lost, 1e-12)
    return lost / gap


@dataclass(frozen=True)
class Gap:
    """Weighted root mean square of measured minus simulated on held-out lines.

    expected_um : of a complete model: noise, and the uncertainty of a fit to the other
        lines
    beside_places_um : of noise alone at the tracker's specification, that between
        places as it was found
    """

    before_um: float
    after_um: float
    noise_floor_um: float
    expected_um: float
    beside_places_um: float


def measure_gap(run_data: Sequence[RunData], baseline: TermFit, best: TermFit) -> Gap:
    """With a fast effect, the samples within cells are included."""
    floor_um, beside_places_um = _compute_noise_floors_um(run_data)
    fast = any(term.is_fast for term in best.terms)
    return Gap(
        floor_um * baseline.held_out.measure_ratio(fast=fast),
        floor_um * best.held_out.measure_ratio(fast=fast),
        floor_um,
        floor_um * best.held_out.expect_ratio(fast=fast),
        beside_places_um,
    )


def _compute_noise_floors_um(run_data: Sequence[RunData]) -> tuple[float, float]:
    """Root mean square of noise alone in a cell: as in the fields of `Gap`."""
    square, cells = np.zeros(2), 0
    for seen, base in ((run.observations, run.base) for run in run_data):
        frame = seen.beam_frame @ base.pose.rotation
        along = np.einsum("nij,nj->ni", frame, seen.direction)
        noises = base.noise, base.noise.typical_with_places
        rms_mm = [expected_rms_mm(seen, noise, along) for noise in noises]
        square += len(seen) * np.square(rms_mm)
        cells += len(seen)
    floor_um, beside_um = (1e3 * np.sqrt(square / cells)).tolist()
    return floor_um, beside_um
