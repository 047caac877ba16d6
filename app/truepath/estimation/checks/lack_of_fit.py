"""Residuals of a fit beyond noise: of cells, of lines, over time.

Everything here is a score test (`score`), of columns B that might be added. A step of
the set-up has the columns of pose and range offset for all cells after it. Sums over
lines, accumulated from the end, give B for all moments at once. Steps count only as far
as slow drift of pose and size does not explain them as well, and as far as they exceed
the residuals that they do not explain: a machine that warms, or an effect missing in
the model, is no step.

The noise is limited to the typical level: otherwise it would absorb what should be
detected. The range offset is free: distances that are all off by more than the
specification are no step, though one near the start would explain them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache

import numpy as np
from jaxtyping import Float64, Int64
from scipy.linalg import block_diag

from truepath.estimation.checks.score import STEP_MARGIN, compute_limit, compute_score
from truepath.estimation.checks.setup_shifts import (
    COLUMNS,
    Candidates,
    Drift,
    Prospects,
    Shared,
    Step,
    StepKinds,
    StepSearch,
    StepSums,
    detect_steps,
)
from truepath.estimation.problem.design_matrix import (
    DesignMatrix,
    Linearisation,
    cut_into_blocks,
)
from truepath.estimation.problem.direction import Fit
from truepath.estimation.problem.information import Information, add_information
from truepath.estimation.problem.noise import (
    cap_correlated_noise,
    total_precision,
)
from truepath.estimation.problem.normal_equations import compute_information
from truepath.kinematics.effects.instrument import RangeStep
from truepath.numerics.correlated_noise import Whitener
from truepath.numerics.scaled_cholesky import ScaledCholesky

_MOST_STEPS = 5
OF_LINE = 0.3  # of the worst line's gain, for a step to come first
_LARGE_MM = 0.02  # of a step
_STRIDE = 12  # cells from one step that is tried to the next
_NEAR = 128  # of these, whose neighbours are kept
_DRIFT = 36  # columns of a drift
_UNSEEN = 1e-8  # of a column's information: the fit explains it all
_FREE = 1.0  # precision of a range offset, mm⁻²: nothing is known of it


@dataclass(frozen=True, slots=True)
class RangeOffsetScore:
    """A range offset as one additional parameter of a Run.

    A wrong home distance, or the constant of another reflector, bends the whole volume
    about the tracker. An error of a machine repeats with the position of its axes
    alone; this one repeats with the distance, and only the part that no machine error
    can follow counts.

    gain : of the fit, χ² of one degree of freedom if the offset is zero
    sigma_mm : standard uncertainty
    """

    gain: float
    offset_mm: float
    sigma_mm: float


@dataclass(frozen=True, slots=True)
class LackOfFit:
    """Residuals of one Run, tested for shifts, steps and drift.

    cell : (n,) squares of the cells' whitened residuals; off_mm : (n,) their size
    begin, end : (l,) cells of each line or standstill
    line : (l,) gain by a shift of each
    square : of all residuals, whitened; freedom : its expectation for noise alone
    drift : gain by a drift of pose and size; drift_mm : its root mean square
    steps : in order of time; at least the best, if one is determined
    explained : gain of steps and drift; drift_left : of a drift given the steps
    unseen : rows before which a large step would be taken for errors of the machine
    range_offset : of the whole Run; None if the data do not determine it
    """

    cell: Float64[np.ndarray, " n"]
    off_mm: Float64[np.ndarray, " n"]
    begin: Int64[np.ndarray, " l"]
    end: Int64[np.ndarray, " l"]
    line: Float64[np.ndarray, " l"]
    square: float
    freedom: float
    drift: float
    drift_mm: float
    steps: tuple[Step, ...]
    explained: float
    drift_left: float
    unseen: frozenset[int]
    range_offset: RangeOffsetScore | None

    @property
    def rest(self) -> float:
        """χ² per degree of freedom left by steps and drift, at least 1."""
        return max(1.0, (self.square - self.explained) / self.freedom)

    @property
    def ratio(self) -> float:
        """Root mean square of the whitened residuals; 1 for noise alone."""
        return float(np.sqrt(self.square / self.freedom))


def assess_lack_of_fit(fit: Fit, number: int, *, names: bool = False) -> LackOfFit:
    """Score tests of one Run of the fit, `number`.

    names : also classify the steps, and test for new range offsets
    """
    examination = _Examination(fit, number)
    lines = examination.seen.lines
    begin = np.array(lines, np.int64)[:, 0]
    within = np.arange(*lines[0], _STRIDE)  # other lines are tested from their end
    found = examination.assess(np.concatenate([within, begin[1:]]), 0)
    limit = 0.7 * compute_step_limit(len(lines))
    limit = max(limit, OF_LINE * float(found.line.max(initial=0.0)))
    if any(step.alone > limit for step in found.steps):
        within = np.concatenate([np.arange(*line, _STRIDE) for line in lines])
        found = examination.assess(within, _MOST_STEPS)
    return examination.name_steps(found) if names else found


class _Examination:
    """One Run linearised about the solution, its noise limited to typical levels."""

    def __init__(self, fit: Fit, number: int) -> None:
        run = fit.runs[number]
        about, known = free_range_offset(fit, number)
        self.seen, self.machine = run.observations, about.machine_model.size
        self.about = replace(about, noise=cap_correlated_noise(run.noise))
        self._solve(known, run.weak)
        time_s = self.seen.at.time_s
        middle, half = 0.5 * (time_s[0] + time_s[-1]), 0.5 * (time_s[-1] - time_s[0])
        self.span_s = float(middle), max(float(half), 1e-9)
        self.centre = self.seen.at.point_mm.mean(axis=0)

    def _solve(self, known: Information, weak: Float64[np.ndarray, "6"] | None) -> None:
        """Solve for machine and pose, given the other information on the machine.

        Noise is correlated within blocks only, as in all that follows: for large steps
        each digit counts.
        """
        data = compute_information(self.seen, self.about, apart=True)
        own, matrix, vector = slice(self.machine), data.matrix, data.vector
        matrix[own, own] += known.matrix
        vector[own] += known.vector
        if weak is not None:
            matrix[self.machine :, self.machine :] += np.diag(weak)
        self.factor = ScaledCholesky.of(matrix)
        self.theta = self.factor.solve(vector)

    def assess(self, starts: Int64[np.ndarray, " l"], most: int) -> LackOfFit:
        """Squares, line shifts, drift and steps of the Run.

        starts : cells before which a step may be
        most : steps that are located to the cell; 0 for the best alone, at its start
        """
        begin, end = np.array(self.seen.lines, np.int64).T
        blocks, sums, later = self._sum_blocks(starts)
        square = sum(block.square for block in blocks)
        freedom = float(sum(block.freedom for block in blocks))
        drift = Drift(self.factor, np.sum([block.drift for block in blocks], axis=0))
        drift_total = np.sum([block.drift_square for block in blocks], axis=0)
        drift_square = drift.size @ drift_total @ drift.size / max(len(self.seen), 1)
        limit = compute_step_limit(len(begin))
        steps, near, share = self._prepare_steps(sums, later, drift)
        search = StepSearch(
            steps,
            near,
            share,
            np.repeat(np.arange(len(begin)), end - begin),
            self.seen.at.time_s,
            lambda gain: limit * max(1.0, (square - gain) / freedom),
            drift.gain,
        )
        found = detect_steps(search, most)
        return LackOfFit(
            np.concatenate([block.cell for block in blocks]),
            np.concatenate([block.off_mm for block in blocks]),
            begin,
            end,
            np.array([gain for block in blocks for gain in block.line]),
            square,
            freedom,
            drift.gain,
            float(np.sqrt(max(drift_square, 0.0))),
            found.steps,
            found.explained,
            found.drift_left,
            self._list_unseen(steps.bare, limit),
            self._score_range_offset(sums),
        )

    def name_steps(self, found: LackOfFit) -> LackOfFit:
        """Classifies the steps.

        Skipped where the surroundings were not recorded: no range offset could be
        solved for.
        """
        if self.seen.at.recorded is None:
            return found
        limit = compute_step_limit(len(found.line)) * found.rest
        steps = [step for step in found.steps if step.gain > limit]
        cells, locks = [step.cell for step in steps], self.seen.new_locks.tolist()
        if not cells and not locks:
            return found
        blocks = map(self._build, cut_into_blocks(self.seen))
        total = np.sum([block.sum_kinds(cells, locks) for block in blocks], axis=0)
        fit, tracker = len(self.factor.scale), self.about.tracker
        half, raw = self.factor.solve_half(total[:fit, :-1]), total[fit:-1, :-1]
        kinds = StepKinds(
            steps,
            locks,
            raw - half.T @ half,
            total[fit:-1, -1],
            self.about.pose.invert().translation_mm - np.array(tracker.centre_mm),
            found.rest,
        )
        return replace(found, steps=tuple(kinds.name()))

    def _score_range_offset(self, sums: StepSums) -> RangeOffsetScore | None:
        if self.seen.at.recorded is None:
            return None
        own = self.machine - 1
        column = np.eye(len(self.theta))[own]
        left = 1.0 / float(self.factor.solve(column)[own]) - _FREE
        if left < _UNSEEN * float(sums.own[0, -1, -1]):
            return None
        offset_mm = float(self.theta[own])
        return RangeOffsetScore(offset_mm**2 * left, offset_mm, left**-0.5)

    def _sum_blocks(
        self, starts: Int64[np.ndarray, " l"]
    ) -> tuple[list[BlockLackOfFit], StepSums, list[StepSums]]:
        """Residuals of each block, steps over the whole Run, and for each block a step
        before all that comes later. Nothing else is kept of a block: there are many.
        """
        sums = StepSums.zeros_at(starts, self._width)
        blocks: list[BlockLackOfFit] = []
        later = [StepSums.zeros_at(np.zeros(1, np.int64), self._width)]
        for cells in reversed(list(cut_into_blocks(self.seen))):
            block = self._build(cells)
            blocks.append(block.assess())
            first, last = np.searchsorted(starts, [cells.start, cells.stop])
            own = block.sum_steps(starts[first:last]).add_later_steps(later[-1])
            sums.put(slice(first, last), own)
            later.append(StepSums.join([own.select(slice(0, 1))]))  # without the rest
        return blocks[::-1], sums, later[-2::-1]

    def _list_unseen(self, steps: Candidates, limit: float) -> frozenset[int]:
        """Rows before which a step of `_LARGE_MM` would not be detected.

        Near both ends of the Run there is too little data for it, and no harm in it.
        """
        later = steps.cell >= self.seen.lines[0][1]
        left, cell = steps.left[later], steps.cell[later]
        information = np.linalg.eigvalsh(left[:, :3, :3])[:, 0]
        unseen = information * _LARGE_MM**2 < limit
        inside = ~np.logical_and.accumulate(unseen)
        inside &= ~np.logical_and.accumulate(unseen[::-1])[::-1]
        return frozenset(self.seen.row[cell[unseen & inside]].tolist())

    @property
    def _width(self) -> int:
        return self.about.size + 1 + _DRIFT + 1

    def _build(self, cells: slice) -> LackOfFitBlock:
        design = self.about.build(self.seen.select(np.r_[cells]))
        rest = design.residual - design.columns @ self.theta
        along = np.tile(np.eye(3)[:, :1], (len(rest), 1, 1))  # of the beam
        drift = self._drift_columns(design)
        parts = [design.columns, along, drift, rest[:, :, None]]
        return LackOfFitBlock(
            cells,
            self.about,
            design,
            design.whiten(self.about.noise),
            np.concatenate(parts, axis=2),
        )

    def _drift_columns(self, design: DesignMatrix) -> Float64[np.ndarray, "n 3 s"]:
        """Pose and strain, each times three Legendre polynomials of time."""
        at = design.observations.at
        pose = design.columns[:, :, self.machine :]
        x, y, z = ((at.point_mm - self.centre) / 1e3).T  # µm/mm is 1e-3
        strain = np.zeros((len(at), 3, 6))
        strain[:, 0, 0], strain[:, 1, 1], strain[:, 2, 2] = x, y, z
        strain[:, 0, 3], strain[:, 0, 4], strain[:, 1, 5] = y, z, z
        columns = np.concatenate([pose, design.frame @ strain], axis=2)
        u = (at.time_s - self.span_s[0]) / self.span_s[1]
        time = (u, 1.5 * u**2 - 0.5, 2.5 * u**3 - 1.5 * u)  # Legendre's
        return np.concatenate([columns * t[:, None, None] for t in time], axis=2)

    def _prepare_steps(
        self, sums: StepSums, later: Sequence[StepSums], drift: Drift
    ) -> tuple[Prospects, Callable[[int], Prospects], Callable[[int], Shared]]:
        # A step before all cells is a matter of the pose.
        steps = drift.eliminate_drift(sums.select(slice(1, None)))
        ends = np.append(sums.cell[1:], len(self.seen))

        @lru_cache(maxsize=2)
        def build(first: int, last: int) -> LackOfFitBlock:
            return self._build(slice(first, last))

        @lru_cache(maxsize=_NEAR)
        def near(k: int) -> Prospects:
            cells = np.arange(ends[k], ends[k + 1], dtype=np.int64)
            found: list[StepSums] = []
            for block, more in zip(cut_into_blocks(self.seen), later, strict=True):
                inside = cells[(cells >= block.start) & (cells < block.stop)]
                if len(inside):
                    own = build(block.start, block.stop).sum_steps(inside)
                    found.append(own.add_later_steps(more))
            return drift.eliminate_drift(StepSums.join(found))

        @cache
        def share(cell: int) -> Shared:
            blocks = list(cut_into_blocks(self.seen))
            number = next(k for k, each in enumerate(blocks) if cell < each.stop)
            block = build(blocks[number].start, blocks[number].stop)
            value = block.share_step(cell) + later[number].own
            return Shared(block.cells.start, value)

        return steps, near, share


def compute_step_limit(lines: int) -> float:
    """Gain that chance rarely exceeds among steps of so many lines."""
    return compute_limit(COLUMNS, lines) * STEP_MARGIN


def free_range_offset(fit: Fit, number: int) -> tuple[Linearisation, Information]:
    """Columns of a Run and the other information on the machine.

    A free range offset is added, where the surroundings were recorded.
    """
    about = fit.runs[number].linearisation
    others = [r for k, r in enumerate(fit.runs) if k != number]
    prior = Information.of_matrix(fit.prior.precision_matrix(fit.model.size))
    known = add_information(
        [fit.known.add_to(prior, fit.model), *(r.own.eliminate() for r in others)]
    )
    at = fit.runs[number].observations.at
    if at.recorded is None:
        return about, known
    offset = RangeStep(at.recorded.set_up, -np.inf)
    free = Information.of_matrix(block_diag(known.matrix, np.array([[_FREE]])))
    vector = np.append(known.vector, 0.0)
    model = about.machine_model.with_effects(offset)
    return replace(about, machine_model=model), replace(free, vector=vector)


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
        weighted = design.weigh(self.whitener, self.columns[:, :, self.step.stop :])
        flat = self.columns.reshape(-1, self.columns.shape[2])
        products = flat.T @ weighted.reshape(len(flat), -1)
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
