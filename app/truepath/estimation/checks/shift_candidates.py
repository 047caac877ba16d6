"""Steps of the set-up before some cells, conditional on fit, drift and each other.

A step has the columns of pose and range offset for all cells after it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from truepath.estimation.checks.score import ScoredColumns
from truepath.numerics.scaled_cholesky import ScaledCholesky

COLUMNS = 7  # of a step: three shifts, three turns, range offset
_AT_ONCE = 256  # steps


@dataclass(frozen=True)
class StepSums:
    """Products of the columns of steps before some cells.

    value : with all columns: of the fit (pose last), range offset, drift, residual
    own : with the columns of the same step
    """

    cell: Int64[np.ndarray, " l"]
    value: Float64[np.ndarray, "l q 7"]
    own: Float64[np.ndarray, "l 7 7"]

    def select(self, part: slice) -> StepSums:
        return StepSums(self.cell[part], self.value[part], self.own[part])

    def put(self, part: slice, steps: StepSums) -> None:
        self.value[part], self.own[part] = steps.value, steps.own

    def add_later_steps(self, later: StepSums) -> StepSums:
        """Steps that continue: adds a step before all that is later."""
        return StepSums(self.cell, self.value + later.value, self.own + later.own)

    @staticmethod
    def zeros_at(cell: Int64[np.ndarray, " l"], width: int) -> StepSums:
        """Zero products for steps before these cells; `width` columns in all."""
        value = np.zeros((len(cell), width, COLUMNS))
        return StepSums(cell, value, np.zeros((len(cell), COLUMNS, COLUMNS)))

    @staticmethod
    def join(parts: Sequence[StepSums]) -> StepSums:
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
    whole: Float64[np.ndarray, "l 7 7"]

    def cut(self) -> Iterator[Candidates]:
        """In batches, to limit memory."""
        return map(self.select, _cut(len(self.cell)))

    @property
    def moved_mm(self) -> Float64[np.ndarray, " l"]:
        """Norm of shift at the middle of the points and range offset."""
        return np.linalg.norm(self.value[:, [0, 1, 2, 6]], axis=1)

    def condition(
        self, steps: Sequence[Candidates], share: Callable[[int], Shared]
    ) -> Candidates:
        """Conditional on steps, one candidate each, whose products `share` provides."""
        given: list[tuple[Candidates, Shared]] = []
        for step in steps:
            shared = share(int(step.cell[0]))
            given.append((step.give_all(given), shared))
        return self.give_all(given)

    def give_all(self, given: Sequence[tuple[Candidates, Shared]]) -> Candidates:
        """Conditional on steps, each of which is conditional on those before it."""
        candidates = self
        for step, shared in given:
            candidates = candidates.condition_on(step, shared.look_up(candidates))
        return candidates


@dataclass(frozen=True)
class Shared:
    """Products of a step with steps before each cell of its block.

    first : cell of the block; value : (n, 7, 7)
    """

    first: int
    value: Float64[np.ndarray, "n 7 7"]

    def look_up(self, candidates: Candidates) -> Float64[np.ndarray, "l 7 7"]:
        """The first product for candidates before the block, `whole` for later ones."""
        inside = candidates.cell - self.first
        near = self.value[np.clip(inside, 0, len(self.value) - 1)]
        later = (inside >= len(self.value))[:, None, None]
        return np.where(later, candidates.whole, near)


@dataclass(frozen=True)
class Prospects:
    """The same steps with and without a drift given."""

    beside: Candidates
    bare: Candidates

    @property
    def cell(self) -> Int64[np.ndarray, " l"]:
        """The first cell after each."""
        return self.beside.cell

    def choose(self, *, drifts: bool) -> Candidates:
        return self.beside if drifts else self.bare

    def select_one(self, k: int) -> Prospects:
        """The leading dimension stays, of length 1."""
        return Prospects(self.beside.select_one(k), self.bare.select_one(k))


class Drift:
    """A drift of the set-up, given the fit.

    sums : products of its columns with those of fit and range offset, with themselves
        and with the residual
    gain : of −2 log likelihood; size : its parameters
    """

    def __init__(
        self, factor: ScaledCholesky, sums: Float64[np.ndarray, "q s"]
    ) -> None:
        self._factor, self._fit = factor, slice(len(factor.scale))
        half, raw = factor.solve_half(sums[self._fit]), sums[self._fit.stop + 1 : -1]
        left, pulled = raw - half.T @ half, sums[None, -1]
        self._columns = ScoredColumns(half[None], raw[None], left[None], pulled)
        self.size = self._columns.value[0]
        self.gain = float(self._columns.gain[0])

    def eliminate_drift(self, steps: StepSums) -> Prospects:
        """Steps with and without the drift given; overwrites `steps` to save memory."""
        fit = self._fit
        whole = steps.value[:, fit.stop - 6 : fit.stop + 1].copy()
        for column in range(fit.stop, steps.value.shape[1] - 2):  # held once, not twice
            steps.value[:, column] = steps.value[:, column + 1]
        known = steps.value[:, :-2]
        for part in _cut(len(known)):
            self._eliminate(known[part])
        raw, half, own = steps.own, known[:, fit], known[:, fit.stop :]
        left, pulled = raw - np.swapaxes(half, 1, 2) @ half, steps.value[:, -1]
        bare = Candidates(half, raw, left, pulled, steps.cell, whole)
        return Prospects(
            bare.eliminate_with(known, own, self._columns.score[1][0]), bare
        )

    def _eliminate(self, sums: Float64[np.ndarray, "l m 7"]) -> None:
        """Replaces products with fit and drift by whitened ones, in place."""
        columns = sums.transpose(1, 0, 2).reshape(sums.shape[1], -1)
        half = self._factor.solve_half(columns[self._fit])
        rest = columns[self._fit.stop :] - self._columns.known[0].T @ half
        own = self._columns.score[0][0].T @ rest
        shared = np.concatenate([half, own]).reshape(-1, len(sums), COLUMNS)
        sums[...] = shared.transpose(1, 0, 2)


def _cut(count: int) -> list[slice]:
    return [slice(k, k + _AT_ONCE) for k in range(0, count, _AT_ONCE)]
