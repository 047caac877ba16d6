"""Steps of the set-up's place before some cells, beside a fit, a drift and each other.

A step has the columns of the pose for all that comes after it. Its score is conditioned
on the fit, on a drift and on other steps by elimination: what columns have in common
with those before them goes with these.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int64

from app.estimation.score import compute_score
from app.numerics.scaled_cholesky import ScaledCholesky


@dataclass(frozen=True)
class StepSums:
    """Products of the columns of steps of the pose before some cells.

    value : with all columns: of the fit, pose last, the residual, the drift
    own : with the columns of the same step
    """

    cell: Int64[np.ndarray, " l"]
    value: Float64[np.ndarray, "l q 6"]
    own: Float64[np.ndarray, "l 6 6"]

    def select(self, part: slice) -> StepSums:
        """Return some of the steps."""
        return StepSums(self.cell[part], self.value[part], self.own[part])

    def go_on(self, later: Sequence[StepSums]) -> StepSums:
        """Return the sums of steps that go on through later blocks."""
        value, own = self.value, self.own
        for block in later:  # before all of its cells
            value, own = value + block.value[0], own + block.own[0]
        return StepSums(self.cell, value, own)

    @staticmethod
    def join(parts: Sequence[StepSums]) -> StepSums:
        """Return the steps of several blocks."""
        return StepSums(
            np.concatenate([part.cell for part in parts]),
            np.concatenate([part.value for part in parts]),
            np.concatenate([part.own for part in parts]),
        )


@dataclass(frozen=True)
class Candidates:
    """Steps before some cells.

    raw : information of their columns; whole : products with a step before all cells
    known : what they share with the fit and what is given beside it
    left, pulled : information and pull that remain
    """

    cell: Int64[np.ndarray, " l"]
    raw: Float64[np.ndarray, "l 6 6"]
    whole: Float64[np.ndarray, "l 6 6"]
    known: Float64[np.ndarray, "l m 6"]
    left: Float64[np.ndarray, "l 6 6"]
    pulled: Float64[np.ndarray, "l 6"]

    @property
    def gain(self) -> Float64[np.ndarray, " l"]:
        """Gain of each."""
        return np.sum(compute_score(self.left, self.raw, self.pulled)[1] ** 2, axis=1)

    @property
    def moved_mm(self) -> Float64[np.ndarray, " l"]:
        """Size of each, at the middle."""
        root, score = compute_score(self.left, self.raw, self.pulled)
        return np.linalg.norm(np.einsum("lij,lj->li", root, score)[:, :3], axis=1)

    def select_one(self, k: int) -> Candidates:
        """Return one of them."""
        one = {name: value[k : k + 1] for name, value in vars(self).items()}
        return Candidates(**one)

    def give(
        self,
        shared: Float64[np.ndarray, "l k 6"],
        root: Float64[np.ndarray, "k j"],
        score: Float64[np.ndarray, " j"],
    ) -> Candidates:
        """Return the candidates beside other columns.

        shared : products with these, what both have in common with the fit taken out
        root, score : of the others
        """
        own = root.T @ shared
        return replace(
            self,
            known=np.concatenate([self.known, own], axis=1),
            left=self.left - np.swapaxes(own, 1, 2) @ own,
            pulled=self.pulled - np.einsum("lji,j->li", own, score),
        )

    def condition(
        self, steps: Sequence[Candidates], share: Callable[[int], Shared]
    ) -> Candidates:
        """Return the candidates beside steps, one each."""
        given: list[_GivenStep] = []
        for step in steps:
            for before in given:
                step = before.add_to(step)
            root, score = compute_score(step.left, step.raw, step.pulled)
            shared = share(int(step.cell[0]))
            given.append(_GivenStep(shared, step.known[0], root[0], score[0]))
        candidates = self
        for step in given:
            candidates = step.add_to(candidates)
        return candidates


@dataclass(frozen=True)
class Shared:
    """Products of a step's columns with those of steps before the cells of its block.

    first : cell of the block; value : (n, 6, 6)
    """

    first: int
    value: Float64[np.ndarray, "n 6 6"]

    def look_up(self, candidates: Candidates) -> Float64[np.ndarray, "l 6 6"]:
        """Return the products with candidates: those before the block cover it all."""
        inside = candidates.cell - self.first
        near = self.value[np.clip(inside, 0, len(self.value) - 1)]
        later = (inside >= len(self.value))[:, None, None]
        return np.where(later, candidates.whole, near)


@dataclass(frozen=True)
class _GivenStep:
    """A step that others are conditioned on.

    known : what its columns share with all before it
    root : R, RRᵀ the inverse of what is left of it; score : Rᵀ times its pull
    """

    shared: Shared
    known: Float64[np.ndarray, "m 6"]
    root: Float64[np.ndarray, "6 6"]
    score: Float64[np.ndarray, "6"]

    def add_to(self, candidates: Candidates) -> Candidates:
        """Return candidates beside this step."""
        shared = self.shared.look_up(candidates) - self.known.T @ candidates.known
        return candidates.give(shared, self.root, self.score)


@dataclass(frozen=True)
class Prospects:
    """The same steps beside a drift and without it."""

    beside: Candidates
    bare: Candidates

    @property
    def cell(self) -> Int64[np.ndarray, " l"]:
        """The first cell after each."""
        return self.beside.cell

    def choose(self, *, drifts: bool) -> Candidates:
        """Return them beside a drift or without one."""
        return self.beside if drifts else self.bare

    def select_one(self, k: int) -> Prospects:
        """Return one of them."""
        return Prospects(self.beside.select_one(k), self.bare.select_one(k))

    def condition(
        self, steps: Sequence[Prospects], share: Callable[[int], Shared]
    ) -> Prospects:
        """Return them beside steps, one each."""
        return Prospects(
            self.beside.condition([step.beside for step in steps], share),
            self.bare.condition([step.bare for step in steps], share),
        )


class Drift:
    """A drift of the set-up, given the fit.

    sums : products of its columns with those of the fit, the residual and its own
    gain : of −2 log likelihood; size : of its parameters
    """

    def __init__(
        self, factor: ScaledCholesky, sums: Float64[np.ndarray, "q s"]
    ) -> None:
        p = len(factor.scale)
        self._factor, self._half = factor, factor.solve_half(sums[:p])
        raw = sums[p + 1 :]
        left = raw - self._half.T @ self._half
        root, score = compute_score(left[None], raw[None], sums[None, p])
        self._root, self._score = root[0], score[0]
        self.size = self._root @ self._score
        self.gain = float(self._score @ self._score)

    def prepare(self, steps: StepSums) -> Prospects:
        """Return steps, beside the drift and without it."""
        sums, raw = steps.value, steps.own
        p, n = len(self._factor.scale), len(sums)
        flat = sums[:, :p].transpose(1, 0, 2).reshape(p, 6 * n)
        half = self._factor.solve_half(flat).reshape(p, n, 6).transpose(1, 0, 2)
        left = raw - np.swapaxes(half, 1, 2) @ half
        whole = sums[:, p - 6 : p]
        bare = Candidates(steps.cell, raw, whole, half, left, sums[:, p])
        shared = sums[:, p + 1 :] - self._half.T @ half
        return Prospects(bare.give(shared, self._root, self._score), bare)
