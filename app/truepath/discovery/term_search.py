"""Stepwise search for terms: addition, exchange and removal by evidence."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from truepath.discovery.term_fitter import EQUIVALENT, TermFit, TermFitter
from truepath.kinematics.effects.family import CandidateTerm

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
    """Searches the terms that Runs have evidence for."""

    def __init__(self, fitter: TermFitter) -> None:
        self._fitter = fitter

    def select_terms(self, start: Sequence[CandidateTerm]) -> TermFit:
        """The fit of all terms with evidence, starting from some."""
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
