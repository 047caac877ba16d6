"""Stepwise search for terms: addition, exchange and removal by evidence.

Terms are fitted to Runs with machine and poses; those not yet in a fit are ranked.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from truepath.discovery.evidence import (
    HeldOutMisfit,
    TermData,
    predict_held_out,
    prior_precision,
)
from truepath.discovery.line_blocks import FoldedLines, Residual, weight_residual
from truepath.discovery.scan import scan_term
from truepath.discovery.term_equations import TermEquations
from truepath.discovery.value_refinement import locate_event, refine_values
from truepath.estimation.noise.baseline import MachinePrior
from truepath.estimation.problem.information import Posterior, compute_posterior
from truepath.kinematics.effects.family import CandidateTerm
from truepath.kinematics.effects.instrument import is_tracker_error

EQUIVALENT = 3.0  # log Bayes factors closer than this decide nothing
_MOST_SCANNED = 4  # terms whose scans are repeated with the machine integrated out
_REACH, _SLACK = 0.3, 10.0  # share of the best one's evidence that a scan may make up
_HOPELESS = -4.0  # evidence that no finer scan raises enough
_DOUBT = 3.0  # times the tracker's specification: few trackers exceed it
_MOST_PROMISING = 12  # terms of a ranking that may replace another later


@dataclass(frozen=True, eq=False)
class TermFit:
    """Machine, poses and terms fitted to the Runs.

    base_size : number of parameters of machine and poses, which come first
    """

    terms: tuple[CandidateTerm, ...]
    base_size: int
    prior: MachinePrior
    posterior: Posterior
    held_out: HeldOutMisfit

    @property
    def misfit(self) -> float:
        """Squared misfit of held-out lines and of earlier Runs, in units of the noise.

        A machine that was measured before may bend towards a missing effect: held-out
        lines then fit as well, and only the earlier knowledge contradicts it.
        """
        departure = self.prior.measure_departure(self.posterior.theta)
        return float(self.held_out.square.sum()) + departure

    @property
    def has_fast(self) -> bool:
        return any(term.is_fast for term in self.terms)

    @property
    def gap_ratio(self) -> float:
        """Misfit of held-out lines over that of a complete model."""
        left, fast = self.held_out, self.has_fast
        return left.measure_ratio(fast=fast) / left.expect_ratio(fast=fast)

    def other_terms(self, term: CandidateTerm) -> list[CandidateTerm]:
        """All terms but one, compared by identity."""
        return [other for other in self.terms if other is not term]

    def part(self, number: int) -> slice:
        begin = self.base_size + sum(term.size for term in self.terms[:number])
        return slice(begin, begin + self.terms[number].size)

    def parameters_of(
        self, number: int
    ) -> tuple[Float64[np.ndarray, " p"], Float64[np.ndarray, "p p"]]:
        part = self.part(number)
        return self.posterior.theta[part], self.posterior.covariance[part, part]


@dataclass(frozen=True)
class RankedTerm:
    """A term and its evidence beyond a fit: log Bayes factor less the search's cost."""

    term: CandidateTerm
    evidence: float


class TermFitter:
    """Fits terms to Runs of one machine, and ranks a catalogue of terms."""

    def __init__(
        self,
        lines: FoldedLines,
        prior: MachinePrior,
        catalogue: Sequence[CandidateTerm],
    ) -> None:
        self._lines, self._equations = lines, TermEquations(lines)
        self._prior, self.catalogue = prior, tuple(catalogue)
        self.run_data = lines.runs
        self._poses = lines.pose_precision
        self._fits: dict[tuple[tuple[CandidateTerm, ...], bool], TermFit] = {}
        self._promising: set[str] = set()
        self._scanned: dict[TermFit, dict[str, CandidateTerm]] = {}
        self._sharpened: dict[tuple[TermFit, CandidateTerm], CandidateTerm] = {}

    def use_lines(self, lines: FoldedLines, prior: MachinePrior) -> TermFitter:
        fitter = TermFitter(lines, prior, self.catalogue)
        fitter._promising |= self._promising
        return fitter

    @property
    def has_tracker_errors(self) -> bool:
        model = self.run_data[0].base.machine_model
        return any(map(is_tracker_error, model.effects))

    def widen_tracker_errors(self) -> TermFitter:
        """A fitter whose tracker may exceed its specification threefold."""
        return self.use_lines(self._lines, self._prior.widen_tracker(_DOUBT))

    def fit(self, terms: Sequence[CandidateTerm], *, refine: bool = True) -> TermFit:
        """Cached for the same terms.

        refine : also the scanned values; else they stay as they are
        """
        is_scanned = any(term.candidate.value is not None for term in terms)
        key = tuple(terms), refine and is_scanned
        if key not in self._fits:
            self._fits[key] = self._fit(*key)
        return self._fits[key]

    def _fit(self, terms: tuple[CandidateTerm, ...], refine: bool) -> TermFit:
        if refine:
            terms = refine_values(self._data(self._prior), terms)
        sums = self._equations.sums([term.effect for term in terms])
        more = prior_precision(self._poses, terms)
        data = sums.information(np.arange(len(more)))
        data = replace(data, matrix=data.matrix + more)
        # The next fit begins with this one's prior.
        self._prior, posterior = self._prior.fit(data)
        precision = prior_precision(self._data(self._prior).precision, terms)
        held_out = predict_held_out(sums, precision)
        return TermFit(terms, self._lines.size, self._prior, posterior, held_out)

    def data_of(self, fit: TermFit) -> TermData:
        return self._data(fit.prior)

    def list_scanned(self) -> list[CandidateTerm]:
        """The catalogue, each term at the value of its latest scan."""
        known: dict[str, CandidateTerm] = {}
        for scanned in self._scanned.values():
            known |= scanned
        return [known.get(term.label, term) for term in self.catalogue]

    def _data(self, prior: MachinePrior) -> TermData:
        precision = prior.precision_matrix(self._lines.size) + self._poses
        return TermData(self._equations, precision)

    def rank(
        self, fit: TermFit, terms: Sequence[CandidateTerm], *, keep: bool = True
    ) -> list[RankedTerm]:
        """Terms by their evidence beyond a fit, greatest first.

        terms : at their present values; keep : cache their columns
        """
        data = self._data(fit.prior)
        log_bayes = data.compare(fit.terms, terms, keep=keep).log_bayes()
        listed = float(np.log(len(self.catalogue)))
        ranked = [
            RankedTerm(term, float(gain) - term.price - listed)
            for term, gain in zip(terms, log_bayes, strict=True)
        ]
        return sorted(ranked, key=_by_evidence)

    def rank_catalogue(
        self, fit: TermFit, among: Sequence[CandidateTerm] | None = None
    ) -> list[RankedTerm]:
        """Scanned terms by their evidence beyond a fit, greatest first.

        among : terms to scan; the whole catalogue if None

        The quick scan ignores the machine: the best terms are scanned again with the
        machine integrated out.
        """
        among = self.catalogue if among is None else among
        ranked = self.rank(fit, self._scan(fit, among))
        best_one = ranked[0].evidence if ranked else 0.0
        least = max(_REACH * best_one - _SLACK, _HOPELESS)
        near = sum(r.evidence > least for r in ranked[:_MOST_SCANNED])
        best = [self._sharpen(fit, r.term) for r in ranked[:near]]
        again = self.rank(fit, best) if best else []
        ranked = sorted([*again, *ranked[near:]], key=_by_evidence)
        free = [r for r in ranked if not r.term.has_cause]
        first = [*ranked[:_MOST_PROMISING], *free[: _MOST_PROMISING // 2]]
        self._promising |= {r.term.label for r in first}
        return ranked

    def rank_promising(
        self, fit: TermFit, among: Sequence[CandidateTerm] | None = None
    ) -> list[RankedTerm]:
        """Limited to terms that were among the best of a ranking before."""
        among = self.catalogue if among is None else among
        return self.rank_catalogue(fit, self.choose_promising(among))

    def find_rivals(
        self, without: TermFit, term: CandidateTerm, evidence: float
    ) -> tuple[CandidateTerm, ...]:
        """Terms with a cause that would explain the Runs as well as one.

        without : the fit without it; evidence : that it adds
        """
        return tuple(
            r.term
            for r in self.rank_promising(without)
            if r.term.label != term.label
            and r.evidence > evidence - EQUIVALENT
            and r.term.has_cause
        )

    def choose_promising(self, among: Sequence[CandidateTerm]) -> list[CandidateTerm]:
        """Terms that were among the best of any ranking so far."""
        return [term for term in among if term.label in self._promising]

    def compare_fits(self, one: TermFit, other: TermFit) -> float:
        """Difference of the log evidence of two fits.

        Mean of two values: with the machine as smooth as suits the one, and the other.
        """
        gains = [
            self._measure_evidence(one, prior) - self._measure_evidence(other, prior)
            for prior in (one.prior, other.prior)
        ]
        return 0.5 * (gains[0] + gains[1])

    def _measure_evidence(self, fit: TermFit, prior: MachinePrior) -> float:
        known = self._data(prior).precision
        typical = np.concatenate(
            [np.zeros(0), *(t.candidate.prior_sigma for t in fit.terms)]
        )
        own = np.arange(len(known), len(known) + len(typical))
        precision = np.pad(known, (0, len(typical)))
        precision[own, own] = typical**-2
        sums = self._equations.sums([term.effect for term in fit.terms])
        found = compute_posterior(
            sums.information(np.arange(len(precision))), precision
        )
        cost = len(fit.terms) * float(np.log(len(self.catalogue)))
        cost += sum(term.price for term in fit.terms) + float(np.log(typical).sum())
        return -0.5 * (found.misfit + found.log_determinant) - cost

    def _scan(
        self, fit: TermFit, among: Sequence[CandidateTerm]
    ) -> list[CandidateTerm]:
        known = self._scanned.setdefault(fit, {})
        present = {term.label for term in fit.terms}
        wanted = [term for term in among if term.label not in present]
        new = [term for term in wanted if term.label not in known]
        if new:
            residuals = self.residuals(fit)
            known |= {term.label: scan_term(term, residuals) for term in new}
        return [known[term.label] for term in wanted]

    def _sharpen(self, fit: TermFit, term: CandidateTerm) -> CandidateTerm:
        if (fit, term) not in self._sharpened:
            best = self._sharpen_value(fit, term)
            self._sharpened |= {(fit, term): best, (fit, best): best}
        return self._sharpened[fit, term]

    def _sharpen_value(self, fit: TermFit, term: CandidateTerm) -> CandidateTerm:
        at = self.run_data[term.run or 0].observations.at
        scan = term.scan(at)
        if scan is None or term.wave(at) is not None:
            return term
        if term.family.happens_once:
            data = self._data(fit.prior)
            moment_s = np.union1d(scan.values, term.candidate.value or 0.0)
            found = data.compare_moments(fit.terms, term, moment_s)
            best = found.terms[int(np.argmax(found.log_bayes()))]
            return locate_event(data, fit.terms, best)
        terms = [term.with_value(float(value)) for value in scan.values]
        return self.rank(fit, [term, *terms], keep=False)[0].term

    def residuals(self, fit: TermFit) -> list[Residual]:
        effects, theta = [t.effect for t in fit.terms], fit.posterior.theta
        return [
            weight_residual(data, self._lines.of(run), effects, theta)
            for run, data in enumerate(self.run_data)
        ]


def _by_evidence(ranked: RankedTerm) -> float:
    return -ranked.evidence


# Log Bayes factor, cost paid. Noise and bends are estimated from the same lines, which
# makes evidence out of nothing: clean Runs bring 5 to 8 in one of fifty.
LEAST_EVIDENCE = 8.0
_MOST_TERMS = 6
_MOST_LARGE, _CLOSED = 3, 1.03  # terms, or gap over that of a complete model
_MOST_FREE = 3  # without a cause: more describe nothing better
LEAST_PURITY = 0.85  # of the evidence, by causes alone, with structure in addition
_TRIED = 2  # terms that held-out lines may reject before the search ends

_Among = Sequence[CandidateTerm] | None


class TermSearch:
    def __init__(self, fitter: TermFitter) -> None:
        self._fitter = fitter

    def select_terms(self, start: Sequence[CandidateTerm]) -> TermFit:
        best = self._add_terms(self._remove_terms(self._fitter.fit(start)))
        return self._remove_terms(self._prefer_causes(best))

    def find_largest(self) -> TermFit:
        """The fit of the few terms that affect the estimate of the noise."""
        best = self._fitter.fit([])
        for _ in range(_MOST_LARGE):
            larger = self._add_terms(best, None, len(best.terms) + 1)
            if larger is best or larger.gap_ratio < _CLOSED:
                return larger
            best = larger
        return best

    def add_among(
        self, start: Sequence[CandidateTerm], among: Sequence[CandidateTerm], most: int
    ) -> TermFit:
        """The fit of some terms and further ones out of a list, `most` in all."""
        return self._add_terms(self._fitter.fit(start, refine=False), among, most)

    def _add_terms(
        self, best: TermFit, among: _Among = None, most: int = _MOST_TERMS
    ) -> TermFit:
        while len(best.terms) < most:
            larger = self._add_term(best, among)
            if larger is None:
                break
            best = self._exchange_term(larger, among)
        return best

    def _add_term(self, best: TermFit, among: _Among) -> TermFit | None:
        free = sum(not term.has_cause for term in best.terms)
        if free >= _MOST_FREE:
            every = self._fitter.catalogue if among is None else among
            among = [term for term in every if term.has_cause]
            among = self._fitter.choose_promising(among)
        for ranked in self._fitter.rank_catalogue(best, among)[:_TRIED]:
            if ranked.evidence < LEAST_EVIDENCE:
                return None
            larger = self._fitter.fit((*best.terms, ranked.term))
            if larger.misfit < best.misfit:
                return larger
        return None

    def _exchange_term(self, best: TermFit, among: _Among) -> TermFit:
        for term in best.terms[:-1]:
            without = self._fitter.fit(best.other_terms(term), refine=False)
            ranked = self._fitter.rank_promising(without, among)
            own = self._fitter.rank(without, [term])[0]
            other = ranked[0] if ranked else own
            if max(other.evidence, own.evidence) < LEAST_EVIDENCE:
                return without
            if other.evidence > own.evidence + EQUIVALENT:
                return self._fitter.fit((*without.terms, other.term))
        return best

    def _remove_terms(self, best: TermFit) -> TermFit:
        """Removes terms without evidence given the others, the least first.

        With the noise fitted again, a term may lose the evidence that it had.
        """
        while best.terms:
            without = [
                self._fitter.fit(best.other_terms(t), refine=False) for t in best.terms
            ]
            evidence = [
                self._fitter.rank(fit, [term])[0].evidence
                for fit, term in zip(without, best.terms, strict=True)
            ]
            least = int(np.argmin(evidence))
            if evidence[least] >= LEAST_EVIDENCE:
                break
            best = without[least]
        return best

    def _prefer_causes(self, best: TermFit) -> TermFit:
        """Replaces structure without a cause by causes that explain as much.

        Several shapes that fit anything may together stand for as many causes or fewer.
        """
        causes = [term for term in best.terms if term.has_cause]
        if len(causes) == len(best.terms):
            return best
        start = self._remove_terms(self._fitter.fit(causes))
        every = [term for term in self._fitter.catalogue if term.has_cause]
        among = self._fitter.choose_promising(every)
        other = self._add_terms(start, among, len(best.terms))
        if {t.label for t in other.terms} == {t.label for t in causes}:
            return best
        nothing = self._fitter.fit([])
        whole = self._fitter.compare_fits(best, nothing)
        if self._fitter.compare_fits(other, nothing) < LEAST_PURITY * whole:
            return best
        other = self._add_terms(other)
        gain = self._fitter.compare_fits(other, best)
        return other if gain > -EQUIVALENT else best
