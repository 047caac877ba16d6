"""Steps of the set-up's place before some cells, beside a fit, a drift and each other.

A step has the columns of the pose for all that comes after it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from app.estimation.score import ScoredColumns
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
class Candidates(ScoredColumns):
    """Steps before some cells.

    whole : products with a step before all cells
    """

    cell: Int64[np.ndarray, " l"]
    whole: Float64[np.ndarray, "l 6 6"]

    @property
    def moved_mm(self) -> Float64[np.ndarray, " l"]:
        """Size of each, at the middle."""
        return np.linalg.norm(self.value[:, :3], axis=1)

    def condition(
        self, steps: Sequence[Candidates], share: Callable[[int], Shared]
    ) -> Candidates:
        """Return the candidates beside steps, one each."""
        given: list[tuple[Candidates, Shared]] = []
        for step in steps:
            shared = share(int(step.cell[0]))
            given.append((step.give_all(given), shared))
        return self.give_all(given)

    def give_all(self, given: Sequence[tuple[Candidates, Shared]]) -> Candidates:
        """Return the candidates beside steps, each beside those before it."""
        candidates = self
        for step, shared in given:
            candidates = candidates.give(step, shared.look_up(candidates))
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
        self._factor, half = factor, factor.solve_half(sums[:p])
        raw = sums[p + 1 :]
        left = raw - half.T @ half
        self._columns = ScoredColumns(half[None], raw[None], left[None], sums[None, p])
        self.size = self._columns.value[0]
        self.gain = float(self._columns.gain[0])

    def prepare(self, steps: StepSums) -> Prospects:
        """Return steps, beside the drift and without it."""
        sums, raw = steps.value, steps.own
        p, n = len(self._factor.scale), len(sums)
        flat = sums[:, :p].transpose(1, 0, 2).reshape(p, 6 * n)
        half = self._factor.solve_half(flat).reshape(p, n, 6).transpose(1, 0, 2)
        left = raw - np.swapaxes(half, 1, 2) @ half
        whole = sums[:, p - 6 : p]
        bare = Candidates(half, raw, left, sums[:, p], steps.cell, whole)
        return Prospects(bare.give(self._columns, sums[:, p + 1 :]), bare)
