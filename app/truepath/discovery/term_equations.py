"""Sums over lines of all candidate effects, cached."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from jaxtyping import Float64, Int64

from truepath.discovery.line_blocks import FOLDS, FoldedLines, WhitenedBlocks
from truepath.estimation.problem.information import Information
from truepath.kinematics.conditions import Conditions
from truepath.kinematics.effects.base import Effect

_KEPT = 256  # effects with cached columns: a catalogue, and those on trial


@dataclass(frozen=True)
class FoldedSums:
    """Sums over each fold of lines; columns are machine, poses, effects, data.

    fold : (k, q, q); freedom : (k,) observations less phases and speeds
    always : (q, q) of the lines that are never held out
    log_determinant : of the noise of all lines
    fast_square, fast_freedom : (k,) of the samples within cells; fast effects have
        their share of them in the sums, the squared data have not
    """

    fold: Float64[np.ndarray, "k q q"]
    freedom: Float64[np.ndarray, " k"]
    always: Float64[np.ndarray, "q q"]
    log_determinant: float
    fast_square: Float64[np.ndarray, " k"]
    fast_freedom: Float64[np.ndarray, " k"]

    @cached_property
    def total(self) -> Float64[np.ndarray, "q q"]:
        return self.fold.sum(axis=0) + self.always

    def information(self, columns: Int64[np.ndarray, " m"]) -> Information:
        """Of all lines on some of the columns."""
        return Information.from_total(self.total, self.log_determinant, columns)


@dataclass(frozen=True)
class CandidateBlocks:
    """Sums over all lines of candidate effects, each with the known columns.

    known : (q, q) on machine, poses, known effects, data
    cross : (q, p) of it with the parameters of each effect; own : (p, p) of each
    """

    known: Float64[np.ndarray, "q q"]
    cross: tuple[Float64[np.ndarray, "q p"], ...]
    own: tuple[Float64[np.ndarray, "p p"], ...]


@dataclass(frozen=True)
class _Term:
    """An effect's columns, and their sums with base and data.

    cross : (k + 1, q, p) over each fold, then over the lines never held out
    pairs : the same with the columns of other effects
    """

    effect: Effect
    blocks: WhitenedBlocks
    cross: Float64[np.ndarray, "f q p"]
    pairs: dict[Effect, Float64[np.ndarray, "f o p"]]

    @cached_property
    def total(self) -> Float64[np.ndarray, "q p"]:
        return self.cross.sum(axis=0)

    @cached_property
    def own(self) -> Float64[np.ndarray, "p p"]:
        return self.blocks.multiply(self.blocks)


class TermEquations:
    """Normal equations of candidate effects; keeps the latest columns."""

    def __init__(self, lines: FoldedLines) -> None:
        self.lines = lines
        self._known: dict[Effect, _Term] = {}
        self._latest: tuple[tuple[Effect, ...], FoldedSums] | None = None

    def sums(self, effects: Sequence[Effect]) -> FoldedSums:
        """On machine, poses, effects and data; the last result is cached."""
        # Many candidates are ranked with the same known effects.
        if self._latest is None or self._latest[0] != tuple(effects):
            self._latest = tuple(effects), self._add_up(effects)
        return self._latest[1]

    def _add_up(self, effects: Sequence[Effect]) -> FoldedSums:
        terms = self._terms_of(effects)
        begin = self._begins(terms)
        end = int(begin[-1])
        base, data = slice(self.lines.size), slice(end, end + 1)
        total = np.zeros((FOLDS + 1, end + 1, end + 1))
        total[:, base, base] = self.lines.ground[:, base, base]
        total[:, data, data] = self.lines.ground[
            :, self.lines.size :, self.lines.size :
        ]
        _put(total, data, base, self.lines.ground[:, self.lines.size :, base])
        parts = [slice(*ends) for ends in pairwise(begin.tolist())]
        for j, (one, mine) in enumerate(zip(terms, parts, strict=True)):
            _put(total, base, mine, one.cross[:, base])
            _put(total, data, mine, one.cross[:, self.lines.size :])
            for other, theirs in zip(terms[: j + 1], parts, strict=False):
                _put(total, theirs, mine, self._pair(other, one))
        fast = self._with_fast(total, begin, effects)
        return FoldedSums(
            total[:-1], self.lines.freedom, total[-1], self.lines.log_determinant, *fast
        )

    def collect_blocks(
        self, known: Sequence[Effect], offers: Sequence[Effect], *, keep: bool = True
    ) -> CandidateBlocks:
        """Sums of candidate effects, each alone with the known columns.

        keep : cache their columns
        """
        total = self.sums(known).total
        known_terms = self._terms_of(known)
        joined = WhitenedBlocks.stack([one.blocks for one in known_terms])
        terms = self._terms_of(offers, keep=keep)
        pairs = [self._cross_known(known_terms, joined, term) for term in terms]
        return CandidateBlocks(
            total, tuple(c for c, _ in pairs), tuple(o for _, o in pairs)
        )

    def collect_blocks_of_moments(
        self,
        known: Sequence[Effect],
        offers: Sequence[Effect],
        moment_s: Float64[np.ndarray, " v"],
    ) -> CandidateBlocks:
        """Sums of candidate effects that differ in their moment alone.

        moment_s : of each, increasing; each effect is permanent from its moment on, so
            that a line depends only on whether it comes before or after
        """
        known_terms, width = self._terms_of(known), len(offers[0].parameters)
        size = int(self._begins(known_terms)[-1]) + 1
        known_blocks = [self.lines.base, *(one.blocks for one in known_terms)]
        cross = np.zeros((len(offers), size, width))
        own = np.zeros((len(offers), width, width))
        for number, line in enumerate(self.lines.lines):
            at = line.design.observations.at
            here = _distinguish(at, moment_s)
            jacobians = [effect.jacobian(at) for effect in offers[here]]
            new = line.whiten(np.concatenate(jacobians, axis=2))
            fixed = [each.between(number, number + 1) for each in known_blocks]
            crossed = _cross(fixed, new).reshape(size, -1, width).transpose(1, 0, 2)
            each = new.rows.reshape(-1, len(crossed), width).transpose(1, 2, 0)
            square = each @ np.swapaxes(each, 1, 2)
            # The first one stands for all before the line.
            begin = np.r_[0, np.arange(here.start + 1, here.stop)]
            cross[begin] += np.diff(crossed, axis=0, prepend=0.0)
            own[begin] += np.diff(square, axis=0, prepend=0.0)
        return CandidateBlocks(
            self.sums(known).total,
            tuple(np.cumsum(cross, axis=0)),
            tuple(np.cumsum(own, axis=0)),
        )

    def multiply(self, effects: Sequence[Effect]) -> Float64[np.ndarray, "p p"]:
        joined = WhitenedBlocks.stack([one.blocks for one in self._terms_of(effects)])
        return np.zeros((0, 0)) if joined is None else joined.multiply(joined)

    def _pair(self, one: _Term, other: _Term) -> Float64[np.ndarray, "f o p"]:
        if one.effect not in other.pairs:
            other.pairs[one.effect] = self.lines.multiply(one.blocks, other.blocks)
        return other.pairs[one.effect]

    def _begins(self, terms: Sequence[_Term]) -> Int64[np.ndarray, " e"]:
        return self.lines.size + np.cumsum([0, *(one.blocks.width for one in terms)])

    def _cross_known(
        self, known: Sequence[_Term], joined: WhitenedBlocks | None, offer: _Term
    ) -> tuple[Float64[np.ndarray, "q p"], Float64[np.ndarray, "p p"]]:
        """Sums of a candidate with the known columns, and with itself.

        joined : the blocks of all known effects, side by side
        """
        others = [] if joined is None else [joined.multiply(offer.blocks)]
        cross = np.concatenate([offer.total[:-1], *others, offer.total[-1:]])
        own, begin = offer.own, self._begins(known)
        for within, _ in self.lines.within:
            if not within.shows(offer.effect):
                continue
            effects = [*(one.effect for one in known), offer.effect]
            fast, columns = within.sums(effects, 1)
            mine = len(columns) - offer.blocks.width
            rows = [begin[k] + p for k, p in columns[:mine]]
            cross[rows] += fast[0, :mine, mine:-1]
            cross[-1] += fast[0, -1, mine:-1]
            own = own + fast[0, mine:-1, mine:-1]
        return cross, own

    def _with_fast(
        self,
        total: Float64[np.ndarray, "f q q"],
        begin: Int64[np.ndarray, " e"],
        effects: Sequence[Effect],
    ) -> tuple[Float64[np.ndarray, " k"], Float64[np.ndarray, " k"]]:
        """Adds fast effects within cells to `total`; their squares and freedom."""
        square, freedom = np.zeros((2, FOLDS))
        for within, is_held in self.lines.within:
            fast, columns = within.sums(effects, FOLDS)
            if columns:
                own = [*(begin[k] + p for k, p in columns), total.shape[1] - 1]
                fast[:, -1, -1] = 0.0
                if is_held:
                    total[np.ix_(range(FOLDS), own, own)] += fast
                else:
                    total[-1][np.ix_(own, own)] += fast.sum(axis=0)
            if is_held:
                square += within.squares(FOLDS)
                freedom += within.freedom(FOLDS)
        return square, freedom

    def _terms_of(self, effects: Sequence[Effect], *, keep: bool = True) -> list[_Term]:
        found = {e: self._known.pop(e) for e in set(effects) & set(self._known)}
        new = [e for e in dict.fromkeys(effects) if e not in found]
        if new:
            found |= dict(zip(new, self._build_terms(new), strict=True))
        kept = effects if keep else [e for e in effects if e not in new]
        self._known |= {e: found[e] for e in kept}  # the newest are last
        for key in list(self._known)[: max(len(self._known) - _KEPT, 0)]:
            del self._known[key]
        return [found[e] for e in effects]

    def _build_terms(self, effects: Sequence[Effect]) -> Iterator[_Term]:
        blocks = self.lines.whiten(effects)
        cross = self.lines.multiply(self.lines.base, blocks)
        ends = np.cumsum([0, *(len(e.parameters) for e in effects)])
        for effect, first, last in zip(effects, ends, ends[1:], strict=False):
            own = slice(int(first), int(last))
            yield _Term(effect, blocks.select(own), cross[:, :, own], {})


def _distinguish(at: Conditions, moment_s: Float64[np.ndarray, " v"]) -> slice:
    first, last = np.searchsorted(moment_s, at.time_s[[0, -1]], "right").tolist()
    return slice(max(first - 1, 0), min(last + 1, len(moment_s)))


def _cross(
    fixed: Sequence[WhitenedBlocks], offers: WhitenedBlocks
) -> Float64[np.ndarray, "q p"]:
    base, *known = (one.multiply(offers) for one in fixed)
    return np.concatenate([base[:-1], *known, base[-1:]])


def _put(
    total: Float64[np.ndarray, "f q q"],
    rows: slice,
    columns: slice,
    block: Float64[np.ndarray, "f r c"],
) -> None:
    total[:, rows, columns] = block
    total[:, columns, rows] = np.swapaxes(block, 1, 2)
