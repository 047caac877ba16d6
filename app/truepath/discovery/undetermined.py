"""Effects that Runs do not distinguish from machine, pose, timing, or each other.

A term whose parameters have the covariance D of typical size, and S as information,
brings the log Bayes factor ½ tr DS − ½ log det (I + DS) on average. Its signal-to-noise
ratio is √(tr DS). Alone, S is that of its own columns; given all other parameters, with
covariance Σ and sums c with the term, it is less by cᵀ Σ c. A group g of them takes
uᵀ (Σ_gg)⁻¹ u of it, with u the rows of Σ c in g.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from jaxtyping import Float64

from truepath.discovery.evidence import TermData, prior_precision
from truepath.discovery.term_search import (
    EQUIVALENT,
    LEAST_EVIDENCE,
    TermFit,
    TermFitter,
)
from truepath.estimation.problem.design_matrix import Linearisation
from truepath.kinematics.effects.base import Effect, Role
from truepath.kinematics.effects.error_motion import AxisLocation, Squareness
from truepath.kinematics.effects.family import Candidate, CandidateTerm, Family
from truepath.kinematics.effects.instrument import is_tracker_error
from truepath.numerics.scaled_cholesky import ScaledCholesky

POSE, TIMING, TRACKER, SQUARENESS = "pose", "timing", "tracker-errors", "squareness"
OTHER = "model"
_CLEAR = 8.0  # signal-to-noise ratio that an ideal test hardly misses
_MOST, _MOST_GROUPS = 12, 4
_LEAST_CORRELATION = 0.7  # correlation below which two terms are not compared

_Matrix = Float64[np.ndarray, "p p"]


@dataclass(frozen=True)
class Undetermined:
    """Candidates of one family and axis that would be clear if all else were known.

    keys : those that all of the candidates share
    ratio : signal-to-noise of the clearest one alone, at typical size
    taken_by : parameters that absorb it, the largest share first: `pose`, `timing`,
        `squareness`, `tracker-errors`, `model`, or an axis for its error motions
    rivals : other effects that would look the same
    """

    family: Family
    keys: dict[str, str]
    ratio: float
    taken_by: tuple[str, ...]
    rivals: tuple[Candidate, ...] = ()


@dataclass(frozen=True)
class _Weighed:
    """A term with its information alone, and given the base.

    cross : (q, p) c; shift : Σ c
    """

    term: CandidateTerm
    alone: _Matrix
    given: _Matrix
    cross: Float64[np.ndarray, "q p"]
    shift: Float64[np.ndarray, "q p"]
    by_timing: bool = False

    @property
    def ratio(self) -> float:
        return float(np.sqrt(_square(self.alone, self.term)))


def list_undetermined(
    fitter: TermFitter, fit: TermFit, named: Collection[str]
) -> tuple[Undetermined, ...]:
    """Names that would be clear alone but are not expected to be found.

    fit : its prior is that of the machine; named : labels of candidates to leave out

    A scanned term counts where this holds at its latest value and in the middle of the
    scan; one that ends with its Run, where it holds in all Runs.
    """
    data, base = fitter.data_of(fit), fitter.run_data[0].base
    terms = [
        term
        for term in fitter.list_scanned()
        if term.has_cause and term.candidate.label not in named
    ]
    listed = float(np.log(len(fitter.catalogue)))
    known = data.equations.sums([]).total[:-1, :-1] + data.precision
    covariance = ScaledCholesky.of(known).invert()
    weighed = _weigh(data, covariance, terms)
    kept = [one for one in weighed if _is_detectable(one.given, one.term, listed)]
    detectable = {one.term.candidate.label for one in kept}
    missed = [one for one in weighed if one.term.candidate.label not in detectable]
    clear = [one for one in missed if one.ratio >= _CLEAR]
    clear += _find_by_timing(data, [one for one in missed if one.ratio < _CLEAR])
    middle = {term.label: term for term in fitter.catalogue}
    again = [middle[one.term.label] for one in clear if one.term.price > 0.0]
    detectable = {
        one.term.candidate.label
        for one in _weigh(data, covariance, again, keep=False)
        if _is_detectable(one.given, one.term, listed)
    }
    clear = [one for one in clear if one.term.candidate.label not in detectable]

    @cache
    def factor(names: frozenset[str]) -> ScaledCholesky:
        rows = _rows(groups, names)
        return ScaledCholesky.of(covariance[np.ix_(rows, rows)])

    def gain(one: _Weighed, names: Collection[str]) -> _Matrix:
        shift = one.shift[_rows(groups, names)]
        return shift.T @ factor(frozenset(names)).solve(shift)

    def find_absorbers(one: _Weighed) -> tuple[str, ...]:
        taken: tuple[str, ...] = (TIMING,) if one.by_timing else ()
        while not one.by_timing and len(taken) < min(_MOST_GROUPS, len(groups)):
            sets = [(*taken, name) for name in groups if name not in taken]
            taken = max(sets, key=lambda names: _square(gain(one, names), one.term))
            if _is_detectable(one.given + gain(one, taken), one.term, listed):
                break
        return taken

    groups = _group(base)
    found = [
        Undetermined(family, keys, best.ratio, find_absorbers(best))
        for best, family, keys in _merge(clear)
    ]
    found += _find_indistinguishable(data, kept)
    lines: dict[tuple[str, str], Undetermined] = {}
    for one in sorted(found, key=_order):
        lines.setdefault((one.family.name, one.keys.get("axis", "")), one)
    return tuple(lines.values())[:_MOST]


def _order(one: Undetermined) -> tuple[bool, float]:
    """The clearest first; errors of a tracker, which few Runs determine, last."""
    of_tracker = one.family.role is Role.MEASUREMENT and TRACKER in one.taken_by
    return of_tracker, -one.ratio


def _weigh(
    data: TermData,
    covariance: Float64[np.ndarray, "q q"],
    terms: Sequence[CandidateTerm],
    *,
    keep: bool = True,
) -> list[_Weighed]:
    blocks = data.equations.collect_blocks([], [t.effect for t in terms], keep=keep)
    weighed: list[_Weighed] = []
    for term, sums, own in zip(terms, blocks.cross, blocks.own, strict=True):
        cross = sums[:-1]
        shift = covariance @ cross
        weighed.append(_Weighed(term, own, own - cross.T @ shift, cross, shift))
    return weighed


def _find_by_timing(data: TermData, weak: Sequence[_Weighed]) -> Iterator[_Weighed]:
    """Those that would be clear if phase and speed of each line were known."""
    weak = [one for one in weak if not one.term.is_fast]
    effects = [one.term.effect for one in weak]
    for one, taken in zip(weak, data.equations.lines.sum_timing(effects), strict=True):
        alone = replace(one, alone=one.alone + taken, by_timing=True)
        if alone.ratio >= _CLEAR and alone.ratio**2 > 2.0 * one.ratio**2:
            yield alone


def _square(S: _Matrix, term: CandidateTerm) -> float:
    """Mean square of the signal-to-noise ratio at typical size."""
    return max(float(np.diag(S) @ term.candidate.prior_sigma**2), 0.0)


def _is_detectable(S: _Matrix, term: CandidateTerm, listed: float) -> bool:
    """True if the search is expected to have evidence for the term."""
    typical = term.candidate.prior_sigma
    _, log_determinant = np.linalg.slogdet(
        np.eye(len(S)) + typical[:, None] * S * typical
    )
    evidence = 0.5 * _square(S, term) - 0.5 * float(log_determinant)
    return evidence - term.price - listed >= LEAST_EVIDENCE


def _group(base: Linearisation) -> dict[str, list[int]]:
    groups: dict[str, list[int]] = {}
    machine = base.machine_model.size
    for effect in base.model.effects:
        part = base.model.slices[effect.name]
        name = POSE if part.start >= machine else _name_group(effect)
        groups.setdefault(name, []).extend(range(part.start, part.stop))
    return groups


def _name_group(effect: Effect) -> str:
    if is_tracker_error(effect):
        return TRACKER
    if isinstance(effect, Squareness):
        return SQUARENESS
    of_axis = effect if isinstance(effect, AxisLocation) else effect.motion
    return of_axis.axis.name if of_axis else OTHER


def _rows(groups: dict[str, list[int]], names: Collection[str]) -> list[int]:
    return sorted(row for name in names for row in groups[name])


def _merge(
    missed: Sequence[_Weighed],
) -> Iterator[tuple[_Weighed, Family, dict[str, str]]]:
    """The clearest of each family and axis, and the keys that all of these share."""
    by_axis: dict[tuple[str, str], list[_Weighed]] = {}
    for one in missed:
        candidate = one.term.candidate
        key = candidate.family, candidate.keys.get("axis", "")
        by_axis.setdefault(key, []).append(one)
    for group in by_axis.values():
        best = max(group, key=lambda one: one.ratio)
        every = [one.term.candidate.keys for one in group]
        keys = {k: v for k, v in every[0].items() if all(e[k] == v for e in every)}
        yield best, best.term.family, keys


def _find_indistinguishable(
    data: TermData, kept: Sequence[_Weighed]
) -> Iterator[Undetermined]:
    """Pairs of which each takes the other's evidence down to what decides nothing."""
    kept = [one for one in kept if not one.term.is_fast]
    if len(kept) < 2:
        return
    cross = np.hstack([one.cross for one in kept])
    shift = np.hstack([one.shift for one in kept])
    own = data.equations.multiply([one.term.effect for one in kept])
    S = own - cross.T @ shift
    size = np.sqrt(np.maximum(np.diag(S), 1e-300))
    begin = np.cumsum([0, *(one.term.size for one in kept)])
    correlation = np.abs(S / size[:, None] / size)
    for axis in (0, 1):
        correlation = np.maximum.reduceat(correlation, begin[:-1], axis=axis)
    for i, j in np.argwhere(np.triu(correlation, 1) > _LEAST_CORRELATION).tolist():
        one, other = kept[i].term, kept[j].term
        a, b = slice(*begin[i : i + 2]), slice(*begin[j : j + 2])
        if all(
            0.5 * _square(S[p, p] - _taken(S, p, q, second), first) < EQUIVALENT
            for p, q, first, second in ((a, b, one, other), (b, a, other, one))
        ):
            keys, rivals = one.candidate.keys, (other.candidate,)
            yield Undetermined(one.family, keys, kept[i].ratio, (), rivals)


def _taken(S: _Matrix, p: slice, q: slice, term: CandidateTerm) -> _Matrix:
    known = S[q, q] + prior_precision(np.zeros((0, 0)), [term])
    return S[p, q] @ np.linalg.solve(known, S[q, p])
