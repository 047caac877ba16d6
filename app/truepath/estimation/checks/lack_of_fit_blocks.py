"""Whole lines of a Run, with the columns of a fit and of possible additions.

The residuals of a block are summarised by sums that add up over the Run, and by squares
of its cells and lines.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int64

from truepath.estimation.checks.score import compute_score
from truepath.estimation.checks.setup_shifts import COLUMNS, StepSums
from truepath.estimation.problem.design_matrix import DesignMatrix, Linearisation
from truepath.estimation.problem.noise import NoiseModel, total_precision
from truepath.numerics.correlated_noise import Whitener


@dataclass(frozen=True, slots=True)
class BlockLackOfFit:
    """Residuals of a block.

    cell : squares of the cells' whitened residuals; off_mm : their size
    line : gain by a shift of each line
    square : of all residuals, whitened; freedom : its expectation for noise alone
    drift : products of all columns with the drift's
    drift_square : of the drift's columns alone, mm²
    """

    cell: Float64[np.ndarray, " n"]
    off_mm: Float64[np.ndarray, " n"]
    line: list[float]
    square: float
    freedom: int
    drift: Float64[np.ndarray, "q s"]
    drift_square: Float64[np.ndarray, "s s"]


@dataclass(frozen=True)
class LackOfFitBlock:
    """Some whole lines of a Run, with their columns.

    columns : of the fit (pose last), range offset, drift, residual
    """

    cells: slice
    about: Linearisation
    design: DesignMatrix
    whitener: Whitener
    columns: Float64[np.ndarray, "n 3 q"]

    @property
    def step(self) -> slice:
        return slice(self.about.machine_model.size, self.about.size + 1)

    @property
    def rest(self) -> Float64[np.ndarray, "n 3"]:
        """Residuals; phase and speed of the lines still in them."""
        return self.columns[:, :, -1]

    @property
    def drift(self) -> Float64[np.ndarray, "n 3 s"]:
        return self.columns[:, :, self.step.stop : -1]

    def assess(self) -> BlockLackOfFit:
        """Squares, line shifts and drift products, timing taken out."""
        design, rest, drift = self.design, self.rest, self.drift
        products = self.multiply(self.columns[:, :, self.step.stop :])
        untimed = rest - design.explain_timing(self.whitener, rest)
        seen = design.observations
        timed = design.timing.shape[2] + self.about.count_untimed(seen)
        precision = total_precision(seen, self.about.noise, design.travel)
        return BlockLackOfFit(
            np.einsum("ni,nij,nj->n", untimed, precision, untimed),
            np.linalg.norm(untimed, axis=1),
            [self.measure_shift(slice(*line)) for line in seen.lines],
            float(products[-1, -1]),
            3 * len(rest) - timed,
            products[:, :-1],
            np.einsum("nip,niq->pq", drift, drift),
        )

    def measure_shift(self, cells: slice) -> float:
        """Score gain, χ² of 3, of a shift of one line, tested alone."""
        design = self.design
        own = replace(
            design,
            observations=design.observations.select(np.r_[cells]),
            frame=design.frame[cells],
            rows=design.rows[cells],
        )
        timing = own.timing.any(axis=(0, 1))
        kept = np.concatenate([np.ones(own.fixed + 1, bool), timing])
        own = replace(own, rows=own.rows[:, :, kept])
        first = self.step.start
        P = own.columns[:, :, first : first + 3]
        weighted = own.weigh(own.whiten(self.about.noise), P).reshape(-1, 3)
        F = P.reshape(-1, 3).T @ weighted
        pulled = self.rest[cells].reshape(-1) @ weighted
        return float(np.sum(compute_score(F[None], F[None], pulled[None])[1] ** 2))

    def multiply(
        self, columns: Float64[np.ndarray, "n 3 k"]
    ) -> Float64[np.ndarray, "q k"]:
        """All columns times V⁻¹ columns, timing taken out."""
        weighted = self.design.weigh(self.whitener, columns)
        flat = self.columns.reshape(-1, self.columns.shape[2])
        return flat.T @ weighted.reshape(len(flat), -1)

    def sum_steps(self, cell: Int64[np.ndarray, " l"]) -> StepSums:
        inside = np.arange(self.cells.start, self.cells.stop, dtype=np.int64)
        after = (inside[:, None] >= cell)[:, None, :, None]
        steps: Float64[np.ndarray, "n 3 l 7"] = (
            self.columns[:, :, None, self.step] * after
        )
        flat = steps.reshape(len(inside), 3, -1)
        weighted = self.design.weigh(self.whitener, flat)
        rows = self.columns.reshape(-1, self.columns.shape[2])
        sums = rows.T @ weighted.reshape(len(rows), -1)
        sums = sums.reshape(-1, len(cell), COLUMNS)
        each, own = (
            c.reshape(len(rows), len(cell), COLUMNS).transpose(1, 2, 0)
            for c in (flat, weighted)
        )
        return StepSums(cell, sums.transpose(1, 0, 2), each @ np.swapaxes(own, 1, 2))

    def sum_kinds(
        self, steps: Sequence[int], locks: Sequence[int]
    ) -> Float64[np.ndarray, "q k"]:
        """Products of all columns with the additions.

        Additions: the drift, steps before some cells of the Run, range offsets before
        others, and the residual. All columns: the fit's, then these.
        """
        inside = np.arange(self.cells.start, self.cells.stop, dtype=np.int64)[:, None]
        after = (inside >= np.array(steps, np.int64))[:, None, :, None]
        step = self.columns[:, :, None, self.step] * after
        late = (inside >= np.array(locks, np.int64))[:, None]
        offsets = self.columns[:, :, self.step.stop - 1, None] * late
        parts = [self.drift, step.reshape(len(inside), 3, -1), offsets]
        added = np.concatenate([*parts, self.rest[:, :, None]], axis=2)
        weighted = self.design.weigh(self.whitener, added)
        fit = self.columns[:, :, : self.about.size]
        flat = np.concatenate([fit, added], axis=2).reshape(3 * len(inside), -1)
        return flat.T @ weighted.reshape(len(flat), -1)

    def share_step(self, cell: int) -> Float64[np.ndarray, "n 7 7"]:
        step = self.columns[:, :, self.step]
        inside = np.arange(self.cells.start, self.cells.stop, dtype=np.int64)
        after = inside >= cell
        weighted = self.design.weigh(self.whitener, step * after[:, None, None])
        each = np.swapaxes(weighted, 1, 2) @ step
        return np.cumsum(each[::-1], axis=0)[::-1]
