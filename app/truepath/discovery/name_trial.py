"""Test of names against free forms: shapes that fit anything of the same kind.

A name claims a shape: constant in time, the same at every point, of one axis, one
harmonic. An unlisted cause may look like it, or like two names at once. So each name,
and all of them together, are compared with structure without a cause in their place:
free functions of time, position, side of approach, speed and direction of the beam.

    lead    the log evidence of the names less that of the free forms: a true shape
            needs fewer numbers for the same lines
    purity  where free forms of its kind remain in addition to a name, the share of the
            evidence of both that the name alone has: a true cause leaves hardly any
            residual
    gap     residual of the names alone on held-out lines above that of a complete
            model, relative to the original one, where the whole explanation leaves some

A name that fails stays possible, and the structure is described instead. So does one
that the tracker could imitate: it loses its evidence where all errors of the tracker
are free at three times their specification. Certain is what stays so there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from truepath.discovery.evidence import HeldOutMisfit
from truepath.discovery.term_search import (
    EQUIVALENT,
    LEAST_EVIDENCE,
    LEAST_PURITY,
    TermFit,
    TermFitter,
    TermSearch,
)
from truepath.kinematics.effects.family import CandidateTerm

CERTAIN, LIKELY, POSSIBLE = "certain", "likely", "possible"
_LEAST_LEAD = -EQUIVALENT  # log evidence of a name over free forms
_CERTAIN_LEAD, _CERTAIN_EVIDENCE = 10.0, 20.0
_OPEN = 1.08  # gap over that of a complete model: clean Runs stay below
_SIGMAS = 4.0  # of the scatter of the squared gap by chance
_MOST_FREE = 4  # free forms in the place of a name


@dataclass(frozen=True)
class Support:
    """The support for a name.

    evidence : log Bayes factor given the others, less the cost of the search
    lead : log evidence over free forms; rivals : other names that do as well
    """

    evidence: float
    lead: float
    rivals: tuple[CandidateTerm, ...]

    @property
    def is_clear(self) -> bool:
        far = self.lead >= _CERTAIN_LEAD
        return far and self.evidence >= _CERTAIN_EVIDENCE and not self.rivals


@dataclass(frozen=True)
class TriedNames:
    """An explanation after the test of its names.

    fit : with the accepted names, and structure
    named : the fit with all names; doubtful : those of its terms that are not accepted
    lead : log evidence of each accepted name over free forms, by label
    doubted : support for each name, by label, with a tracker that may exceed its
        specification by far; empty for a perfect one
    """

    fit: TermFit
    named: TermFit
    doubtful: tuple[CandidateTerm, ...]
    lead: dict[str, float]
    doubted: dict[str, Support]

    def is_imitated(self, term: CandidateTerm) -> bool:
        """True if a tracker beyond its specification could produce the effect."""
        doubted = self.doubted.get(term.label)
        return doubted is not None and doubted.evidence < LEAST_EVIDENCE

    def grade(
        self, term: CandidateTerm, evidence: float, rivals: tuple[CandidateTerm, ...]
    ) -> str:
        """`certain`, `likely` or `possible`; evidence, rivals : as in its support"""
        if term in self.doubtful:
            return POSSIBLE
        if term.family.tracker_may_imitate:
            return LIKELY
        own = Support(evidence, self.lead.get(term.label, 0.0), rivals)
        is_clear = own.is_clear and self.doubted.get(term.label, own).is_clear
        alone = all(other.has_cause for other in self.fit.terms)
        return CERTAIN if alone and is_clear and not is_open(self.fit) else LIKELY


def is_open(fit: TermFit) -> bool:
    """True if held-out lines are predicted worse than by a complete model."""
    by_chance = float(np.sqrt(2.0 / fit.held_out.freedom.sum()))
    return fit.gap_ratio**2 > _OPEN**2 + _SIGMAS * by_chance


class NameTrial:
    """Tests the names of a fit against structure without a cause."""

    def __init__(self, fitter: TermFitter, search: TermSearch) -> None:
        self._fitter, self._search = fitter, search
        free = [term for term in fitter.catalogue if not term.has_cause]
        self._free = fitter.choose_promising(free)
        self._flexible = [term for term in self._free if term.family.varies_with]

    def assess(self, best: TermFit) -> TriedNames:
        """The accepted names, and those that are not."""
        names = [term for term in best.terms if term.has_cause]
        if not names or self._need_more(best, names):
            return self._replace_doubtful(best, names)
        lead = {n.label: self._measure_lead(best, [n]) for n in names}
        doubted = self._widen_tracker_errors(best, names)
        weighed = TriedNames(best, best, (), lead, doubted)
        doubtful = [
            n
            for n in names
            if weighed.is_imitated(n) or self._fails(best, n, lead[n.label])
        ]
        if len(names) > 1 and self._measure_lead(best, names) < _LEAST_LEAD:
            doubtful = names
        fit = self._replace(best, doubtful, self._free) if doubtful else best
        tried = replace(weighed, fit=fit, doubtful=tuple(doubtful))
        kept = [term for term in names if term not in doubtful]
        if doubtful and kept and self._need_more(fit, kept):
            return replace(self._replace_doubtful(best, names), doubted=doubted)
        return tried

    def _replace_doubtful(
        self, best: TermFit, names: Sequence[CandidateTerm]
    ) -> TriedNames:
        fit = self._replace(best, names, self._free) if names else best
        return TriedNames(fit, best, tuple(names), {}, {})

    def _widen_tracker_errors(
        self, best: TermFit, names: Sequence[CandidateTerm]
    ) -> dict[str, Support]:
        if not self._fitter.has_tracker_errors:
            return {}
        fitter = self._fitter.widen_tracker_errors()
        trial = NameTrial(fitter, TermSearch(fitter))
        whole = fitter.fit(best.terms, refine=False)
        return {name.label: trial._support(whole, name) for name in names}

    def _support(self, best: TermFit, name: CandidateTerm) -> Support:
        without = self._fitter.fit(best.other_terms(name), refine=False)
        evidence = self._fitter.rank(without, [name])[0].evidence
        rivals = self._fitter.find_rivals(without, name, evidence)
        return Support(evidence, self._measure_lead(best, [name]), rivals)

    def _replace(
        self,
        best: TermFit,
        out: Sequence[CandidateTerm],
        among: Sequence[CandidateTerm],
    ) -> TermFit:
        kept = [term for term in best.terms if term not in out]
        most = len(kept) + max(_MOST_FREE, len(out))
        return self._search.add_among(kept, among, most)

    def _measure_lead(self, best: TermFit, names: Sequence[CandidateTerm]) -> float:
        """Log evidence of names over that of free forms in their place.

        The free forms are not fitted where several of the best one's evidence could not
        reach the names'.
        """
        kept = [term for term in best.terms if term not in names]
        without = self._fitter.fit(kept, refine=False)
        own = self._fitter.compare_fits(best, without)
        ranked = self._fitter.rank_promising(without, self._flexible)
        most = _MOST_FREE * max([0.0, *(r.evidence for r in ranked[:1])])
        if own - most >= _CERTAIN_LEAD:
            return own - most
        instead = self._replace(best, names, self._flexible)
        return self._fitter.compare_fits(best, instead)

    def _fails(self, best: TermFit, name: CandidateTerm, lead: float) -> bool:
        """True if a name is not accepted.

        With structure left in addition, it has to be clearly better than a free form.
        """
        is_alone = all(term.has_cause for term in best.terms)
        if lead < (_LEAST_LEAD if is_alone else _CERTAIN_LEAD):
            return True
        structure = [term for term in best.terms if _is_rival_structure(term, name)]
        return (
            bool(structure) and self._find_purity(best, name, structure) < LEAST_PURITY
        )

    def _find_purity(
        self, best: TermFit, name: CandidateTerm, structure: Sequence[CandidateTerm]
    ) -> float:
        kept = [t for t in best.terms if t is not name and t not in structure]
        nothing = self._fitter.fit(kept, refine=False)
        alone = self._fitter.fit([*kept, name])
        both = self._fitter.compare_fits(best, nothing)
        return self._fitter.compare_fits(alone, nothing) / max(both, 1e-9)

    def _need_more(self, fit: TermFit, names: Sequence[CandidateTerm]) -> bool:
        structure = [t for t in fit.terms if t not in names and not t.has_cause]
        if not structure and not is_open(fit):
            return False
        nothing = self._fitter.fit([])
        alone = self._fitter.fit(names, refine=False) if structure else fit
        whole = self._fitter.compare_fits(fit, nothing)
        if self._fitter.compare_fits(alone, nothing) < LEAST_PURITY * whole:
            return True
        fast, least = fit.has_fast, 1.0 - LEAST_PURITY
        left, before = (_excess(f.held_out, fast=fast) for f in (alone, nothing))
        return is_open(fit) and left > least * before


def _excess(left: HeldOutMisfit, *, fast: bool) -> float:
    return left.measure_ratio(fast=fast) ** 2 - left.expect_ratio(fast=fast) ** 2


def _is_rival_structure(term: CandidateTerm, name: CandidateTerm) -> bool:
    kind = name.family.varies_with
    return not term.has_cause and bool(kind) and term.family.varies_with == kind
