"""What a fit leaves that noise does not explain: of cells, of lines, of time.

Everything here is a score test (`score`), of columns B that might be added.

A step of the set-up has the columns of pose and range offset for all that comes after
it. Sums over lines, accumulated from the end, give B for all moments
at once. Steps count only as far as slow drift of pose and size does not explain them as
well, and as far as they stand out from what they do not explain: a machine that warms,
or an effect that the model lacks, is no knock.

The noise is at most what is usual here: it must not explain what it should show. And
the range offset is free: distances that are all off by more than the specification says
are no step, though one near the begin would explain them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache

import numpy as np
from jaxtyping import Float64, Int64
from scipy.linalg import block_diag
from scipy.special import chdtri

from truepath.estimation.checks.misfit_blocks import BlockMisfit, MisfitBlock
from truepath.estimation.checks.setup_steps import Step, StepSearch, find_steps
from truepath.estimation.checks.step_candidates import (
    COLUMNS,
    Candidates,
    Drift,
    Prospects,
    Shared,
    StepSums,
)
from truepath.estimation.checks.step_kinds import StepKinds
from truepath.estimation.problem.design_matrix import (
    DesignMatrix,
    Linearisation,
    cut_into_blocks,
)
from truepath.estimation.problem.direction import Fit
from truepath.estimation.problem.information import Information, add_information
from truepath.estimation.problem.noise import limit_noise
from truepath.estimation.problem.normal_equations import compute_information
from truepath.kinematics.effects.instrument import RangeStep, name_set_up
from truepath.numerics.scaled_cholesky import ScaledCholesky

_RISK, _STEP_MARGIN = 0.003, 1.7  # of a clean measurement; noise has longer tails
_MOST_STEPS = 5
OF_LINE = 0.3  # of the worst line's gain, for a step to come first
_LARGE_MM = 0.02  # of a step
_STRIDE = 12  # cells from one step that is tried to the next
_NEAR = 128  # of these, whose neighbours are kept
_DRIFT = 36  # columns of a drift


@dataclass(frozen=True, slots=True)
class Misfit:
    """What the fit leaves of one Run.

    cell : (n,) squares of the cells' residuals, whitened; off_mm : (n,) their size
    begin, end : (l,) cells of each line or standstill
    line : (l,) gain of a shift of each
    square : of all residuals, whitened; freedom : what noise alone would make of it
    drift : gain of a drift of pose and size; drift_mm : root mean square of it
    steps : in the order of time; at least the best, where one can be told
    explained : gain of steps and drift; drift_left : of a drift beside the steps
    unseen : rows before which a large step would pass for errors of the machine
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

    @property
    def rest(self) -> float:
        """What neither steps nor drift explain, of what noise alone would leave."""
        return max(1.0, (self.square - self.explained) / self.freedom)

    @property
    def ratio(self) -> float:
        """Root mean square of the residuals, of what noise alone would leave."""
        return float(np.sqrt(self.square / self.freedom))


def assess_misfit(fit: Fit, number: int, *, names: bool = False) -> Misfit:
    """Return what the fit leaves of one of its Runs.

    names : say what the steps are as well, and look for new range offsets
    """
    examination = _Examination(fit, number)
    lines = examination.seen.lines
    begin = np.array(lines, np.int64)[:, 0]
    within = np.arange(*lines[0], _STRIDE)  # else looked at from its end
    found = examination.assess(np.concatenate([within, begin[1:]]), 0)
    limit = 0.7 * compute_step_limit(len(lines))
    limit = max(limit, OF_LINE * float(found.line.max(initial=0.0)))
    if any(step.alone > limit for step in found.steps):
        within = np.concatenate([np.arange(*line, _STRIDE) for line in lines])
        found = examination.assess(within, _MOST_STEPS)
    return examination.name_steps(found) if names else found


class _Examination:
    """One Run about the solution under the usual noise."""

    def __init__(self, fit: Fit, number: int) -> None:
        run = fit.runs[number]
        about, known = free_range_offset(fit, number)
        self.seen, self.machine = run.observations, about.machine_model.size
        self.about = replace(about, noise=limit_noise(run.noise))
        self._solve(known, run.weak)
        time_s = self.seen.at.time_s
        middle, half = 0.5 * (time_s[0] + time_s[-1]), 0.5 * (time_s[-1] - time_s[0])
        self.span_s = float(middle), max(float(half), 1e-9)
        self.centre = self.seen.at.point_mm.mean(axis=0)

    def _solve(self, known: Information, weak: Float64[np.ndarray, "6"] | None) -> None:
        """Solve for machine and pose, what else is known of the machine given.

        With noise that is correlated within blocks alone, as in all that follows: of
        large steps each digit counts.
        """
        data = compute_information(self.seen, self.about, apart=True)
        own, matrix, vector = slice(self.machine), data.matrix, data.vector
        matrix[own, own] += known.matrix
        vector[own] += known.vector
        if weak is not None:
            matrix[self.machine :, self.machine :] += np.diag(weak)
        self.factor = ScaledCholesky.of(matrix)
        self.theta = self.factor.solve(vector)

    def assess(self, starts: Int64[np.ndarray, " l"], most: int) -> Misfit:
        """Return what the fit leaves.

        starts : cells before which a step may be
        most : steps that are placed to the cell; 0 for the best alone, where it starts
        """
        begin, end = np.array(self.seen.lines, np.int64).T
        blocks, sums, later = self._sum_blocks(starts)
        square = sum(block.square for block in blocks)
        freedom = float(sum(block.freedom for block in blocks))
        drift = Drift(self.factor, np.sum([block.drift for block in blocks], axis=0))
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
        found = find_steps(search, most)
        return Misfit(
            np.concatenate([block.cell for block in blocks]),
            np.concatenate([block.off_mm for block in blocks]),
            begin,
            end,
            np.array([gain for block in blocks for gain in block.line]),
            square,
            freedom,
            drift.gain,
            self._size_drift(blocks, drift),
            found.steps,
            found.explained,
            found.drift_left,
            self._list_unseen(steps.bare, limit),
        )

    def name_steps(self, found: Misfit) -> Misfit:
        """Return what the fit leaves, its steps with what they are.

        Not where it is unknown how the tracker looks: no offset could be solved for.
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

    def _sum_blocks(
        self, starts: Int64[np.ndarray, " l"]
    ) -> tuple[list[BlockMisfit], StepSums, list[StepSums]]:
        """Return what is left of each block, and steps all over the Run.

        And for each block a step before all that comes later. Nothing else is kept of
        a block: there are many.
        """
        sums = StepSums.of_none(starts, self._width)
        blocks: list[BlockMisfit] = []
        later = [StepSums.of_none(np.zeros(1, np.int64), self._width)]
        for cells in reversed(list(cut_into_blocks(self.seen))):
            block = self._build(cells)
            blocks.append(block.assess())
            first, last = np.searchsorted(starts, [cells.start, cells.stop])
            own = block.sum_steps(starts[first:last]).go_on(later[-1])
            sums.put(slice(first, last), own)
            later.append(StepSums.join([own.select(slice(0, 1))]))  # without the rest
        return blocks[::-1], sums, later[-2::-1]

    def _size_drift(self, blocks: Sequence[BlockMisfit], drift: Drift) -> float:
        """Return the root mean square of a drift over the cells, in mm."""
        total = np.sum([block.drift_square for block in blocks], axis=0)
        square = drift.size @ total @ drift.size / max(len(self.seen), 1)
        return float(np.sqrt(max(square, 0.0)))

    def _list_unseen(self, steps: Candidates, limit: float) -> frozenset[int]:
        """Return the rows before which a step of `_LARGE_MM` would not show.

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

    def _build(self, cells: slice) -> MisfitBlock:
        design = self.about.build(self.seen.select(np.r_[cells]))
        rest = design.residual - design.columns @ self.theta
        along = np.tile(np.eye(3)[:, :1], (len(rest), 1, 1))  # of the beam
        drift = self._drift_columns(design)
        parts = [design.columns, along, drift, rest[:, :, None]]
        return MisfitBlock(
            cells,
            self.about,
            design,
            design.whiten(self.about.noise),
            np.concatenate(parts, axis=2),
        )

    def _drift_columns(self, design: DesignMatrix) -> Float64[np.ndarray, "n 3 s"]:
        """Return pose and strain, each growing with polynomials of time."""
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
        """Return steps all over the Run, those from one to the next, what they share.

        later : a step before all that comes after each block
        """
        # A step before all cells is a matter of the pose.
        steps = drift.prepare(sums.select(slice(1, None)))
        ends = np.append(sums.cell[1:], len(self.seen))

        @lru_cache(maxsize=2)
        def build(first: int, last: int) -> MisfitBlock:
            return self._build(slice(first, last))

        @lru_cache(maxsize=_NEAR)
        def near(k: int) -> Prospects:
            cells = np.arange(ends[k], ends[k + 1], dtype=np.int64)
            found: list[StepSums] = []
            for block, more in zip(cut_into_blocks(self.seen), later, strict=True):
                inside = cells[(cells >= block.start) & (cells < block.stop)]
                if len(inside):
                    own = build(block.start, block.stop).sum_steps(inside)
                    found.append(own.go_on(more))
            return drift.prepare(StepSums.join(found))

        @cache
        def share(cell: int) -> Shared:
            blocks = list(cut_into_blocks(self.seen))
            number = next(k for k, each in enumerate(blocks) if cell < each.stop)
            block = build(blocks[number].start, blocks[number].stop)
            value = block.share_step(cell) + later[number].own
            return Shared(block.cells.start, value)

        return steps, near, share


def compute_step_limit(lines: int) -> float:
    """Return the gain of a step that chance seldom makes in so many lines."""
    return float(chdtri(COLUMNS, _RISK / max(lines, 1))) * _STEP_MARGIN


def free_range_offset(fit: Fit, number: int) -> tuple[Linearisation, Information]:
    """Return the columns of a Run and what else is known of the machine.

    A range offset of which nothing is known is one more, where it is known how the
    tracker looks.
    """
    about, known = fit.runs[number].linearisation, collect_known(fit, number)
    at = fit.runs[number].observations.at
    if at.recorded is None:
        return about, known
    offset = RangeStep(name_set_up(at.recorded, at.machine.tracker.face), -np.inf)
    free = Information.of_matrix(block_diag(known.matrix, offset.prior().form))
    vector = np.append(known.vector, 0.0)
    model = about.machine_model.with_effects(offset)
    return replace(about, machine_model=model), replace(free, vector=vector)


def collect_known(fit: Fit, number: int) -> Information:
    """Return what is known of the machine without one of the Runs."""
    others = [r for k, r in enumerate(fit.runs) if k != number]
    prior = Information.of_matrix(fit.prior.precision_matrix(fit.model.size))
    return add_information(
        [fit.known.add_to(prior, fit.model), *(r.own.eliminate() for r in others)]
    )
