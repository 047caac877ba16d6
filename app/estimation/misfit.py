"""What a fit leaves that noise does not explain: of cells, of lines, of time.

Everything here is a score test (Rao 1948): how far would the fit improve if a parameter
were added, told by the residuals of the fit as it is, without another solve. With
r = y − Aθ, W = V⁻¹ (timing of the lines taken out), H = AᵀWA + prior and columns B of
what might be added, the gain is gᵀF⁻¹g with g = BᵀWr and F = BᵀWB − BᵀWA H⁻¹ AᵀWB.

A step of the tracker's or the reflector's place has the columns of the pose for all
that comes after it. Sums over lines, accumulated from the end, give B for all moments
at once. Steps count only as far as slow drift of pose and size does not explain them as
well, and as far as they stand out from what they do not explain: a machine that warms,
or an effect that the model lacks, is no knock.

The noise is at most what is usual here: it must not explain what it should show.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache

import numpy as np
from jaxtyping import Float64, Int64
from scipy.special import chdtri

from app.estimation.design_matrix import DesignMatrix, Linearisation
from app.estimation.direction import Fit
from app.estimation.information import Information, add_information
from app.estimation.noise import NoiseModel, total_precision
from app.estimation.setup_steps import (
    UNSEEN,
    Drift,
    Prospects,
    Shared,
    Step,
    StepSearch,
    StepSums,
    compute_score,
    find_steps,
)
from app.numerics.correlated_noise import Whitener
from app.numerics.scaled_cholesky import ScaledCholesky

_MOST_OU, _LONGEST_OU_S = 0.3, 2.0  # of the stated noise: more is for a test to show
_DRIFTS = 36  # pose and strain, each with three polynomials of time
_RISK, _STEP_MARGIN = 0.003, 1.7  # of a clean measurement; noise has longer tails
_MOST_STEPS = 5
OF_LINE = 0.3  # of the worst line's gain, for a step to come first
_CELLS = 500  # of a block
_STRIDE = 12  # cells from one step that is tried to the next


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

    @property
    def rest(self) -> float:
        """What neither steps nor drift explain, of what noise alone would leave."""
        return max(1.0, (self.square - self.explained) / self.freedom)

    @property
    def ratio(self) -> float:
        """Root mean square of the residuals, of what noise alone would leave."""
        return float(np.sqrt(self.square / self.freedom))


def assess_misfit(fit: Fit, number: int) -> Misfit:
    """Return what the fit leaves of one of its Runs."""
    examination = _Examination(fit, number)
    found = examination.assess()
    limit = 0.7 * compute_step_limit(len(found.line))
    limit = max(limit, OF_LINE * float(found.line.max(initial=0.0)))
    if any(step.alone > limit for step in found.steps):
        # Of large steps each digit counts.
        examination.settle()
        found = examination.assess()
    return found


@dataclass(frozen=True)
class _Block:
    """Some whole lines of a Run, with the columns of fit, residual and drift.

    pose : where the columns of the pose are
    """

    cells: slice
    design: DesignMatrix
    whitener: Whitener
    columns: Float64[np.ndarray, "n 3 q"]
    pose: slice

    @property
    def rest(self) -> Float64[np.ndarray, "n 3"]:
        """What the fit leaves, phase and speed of the lines still in it."""
        return self.columns[:, :, self.pose.stop]

    @property
    def drift(self) -> Float64[np.ndarray, "n 3 s"]:
        """Columns of the drift."""
        return self.columns[:, :, self.pose.stop + 1 :]

    def multiply(
        self, columns: Float64[np.ndarray, "n 3 k"]
    ) -> Float64[np.ndarray, "q k"]:
        """Return the products of all columns with others."""
        weighted = weigh(self.design, self.whitener, columns)
        flat = self.columns.reshape(-1, self.columns.shape[2])
        return flat.T @ weighted.reshape(len(flat), -1)

    def sum_steps(self, cell: Int64[np.ndarray, " l"]) -> StepSums:
        """Return the sums of steps of the pose before some cells of the Run."""
        inside = np.arange(self.cells.start, self.cells.stop, dtype=np.int64)
        after = (inside[:, None] >= cell)[:, None, :, None]
        steps: Float64[np.ndarray, "n 3 l 6"] = (
            self.columns[:, :, None, self.pose] * after
        )
        flat = steps.reshape(len(inside), 3, -1)
        weighted = weigh(self.design, self.whitener, flat)
        rows = self.columns.reshape(-1, self.columns.shape[2])
        sums = (rows.T @ weighted.reshape(len(rows), -1)).reshape(-1, len(cell), 6)
        each, own = (
            c.reshape(len(rows), len(cell), 6).transpose(1, 2, 0)
            for c in (flat, weighted)
        )
        return StepSums(cell, sums.transpose(1, 0, 2), each @ np.swapaxes(own, 1, 2))

    def share_step(self, cell: int) -> Float64[np.ndarray, "n 6 6"]:
        """Return products of a step with steps before each of the block's cells."""
        pose = self.columns[:, :, self.pose]
        inside = np.arange(self.cells.start, self.cells.stop, dtype=np.int64)
        after = inside >= cell
        weighted = weigh(self.design, self.whitener, pose * after[:, None, None])
        each = np.swapaxes(weighted, 1, 2) @ pose
        return np.cumsum(each[::-1], axis=0)[::-1]


class _Examination:
    """One Run about the solution under the usual noise."""

    def __init__(self, fit: Fit, number: int) -> None:
        run = fit.runs[number]
        noise = limit_noise(run.noise)
        run = run if noise == run.noise else run.replace_noise(noise)
        self.seen, self.about = run.observations, run.linearisation
        self.machine = self.about.machine_model.size
        self.known, self.is_settled = collect_known(fit, number), False
        self._solve(run.data.matrix, run.data.vector)
        time_s = self.seen.at.time_s
        middle, half = 0.5 * (time_s[0] + time_s[-1]), 0.5 * (time_s[-1] - time_s[0])
        self.span_s = float(middle), max(float(half), 1e-9)
        self.centre = self.seen.at.point_mm.mean(axis=0)
        self.starts = np.array(self.seen.lines, np.int64)[:, 0]

    def _solve(
        self, matrix: Float64[np.ndarray, "p p"], vector: Float64[np.ndarray, " p"]
    ) -> None:
        """Solve for machine and pose, what else is known of the machine given."""
        own = slice(self.machine)
        matrix, vector = matrix.copy(), vector.copy()
        matrix[own, own] += self.known.matrix
        vector[own] += self.known.vector
        self.factor = ScaledCholesky.of(matrix)
        self.theta = self.factor.solve(vector)

    def settle(self) -> None:
        """Solve again with noise that is correlated within blocks alone, as here."""
        p = self.about.size
        total = np.zeros((p, p + 1))
        for cells in self._cut():
            block = self._build(cells)
            total += block.multiply(block.columns[:, :, : p + 1])[:p]
        matrix = total[:, :p]
        self._solve(matrix, total[:, p] + matrix @ self.theta)
        self.is_settled = True
        self.starts = np.concatenate(
            [np.arange(*line, _STRIDE) for line in self.seen.lines]
        )

    def assess(self) -> Misfit:
        """Return what the fit leaves."""
        begin, end = np.array(self.seen.lines, np.int64).T
        squares: list[Float64[np.ndarray, " k"]] = []
        off: list[Float64[np.ndarray, " k"]] = []
        shifts: list[float] = []
        sums: list[StepSums] = []
        products: list[Float64[np.ndarray, "q s"]] = []
        drift_square = np.zeros((_DRIFTS, _DRIFTS))
        square, freedom = 0.0, 3.0 * len(self.seen)
        for cells in self._cut():
            block = self._build(cells)
            design, rest, noise = block.design, block.rest, self.about.noise
            inside = self.starts[self.starts >= cells.start]
            sums.append(block.sum_steps(inside[inside < cells.stop]))
            products.append(block.multiply(block.drift))
            drift_square += np.einsum("nip,niq->pq", block.drift, block.drift)
            weighted = weigh(design, block.whitener, rest[:, :, None])
            square += float(np.sum(rest[:, :, None] * weighted))
            freedom -= design.timing.shape[2] + _count_untimed(design, self.about)
            shifts += [
                self._shift(design, rest, slice(*line))
                for line in design.observations.lines
            ]
            rest = rest - explain_timing(design, block.whitener, rest)
            squares.append(_cell_squares(design, rest, noise))
            off.append(np.linalg.norm(rest, axis=1))
        drift = Drift(self.factor, np.sum(products, axis=0))
        size = drift.size @ drift_square @ drift.size / max(len(self.seen), 1)
        limit = compute_step_limit(len(begin))
        search = StepSearch(
            *self._prepare_steps(sums, drift),
            np.repeat(np.arange(len(begin)), end - begin),
            self.seen.at.time_s,
            lambda gain: limit * max(1.0, (square - gain) / freedom),
            drift.gain,
        )
        found = find_steps(search, _MOST_STEPS if self.is_settled else 0)
        return Misfit(
            np.concatenate(squares),
            np.concatenate(off),
            begin,
            end,
            np.array(shifts),
            square,
            freedom,
            drift.gain,
            float(np.sqrt(max(size, 0.0))),
            found.steps,
            found.explained,
            found.drift_left,
        )

    def _cut(self) -> Iterator[slice]:
        """Yield the cells of blocks of whole lines."""
        first = 0
        for _, last in self.seen.lines:
            if last - first >= _CELLS or last == len(self.seen):
                yield slice(first, last)
                first = last

    def _build(self, cells: slice) -> _Block:
        design = self.about.build(self.seen.select(np.r_[cells]))
        rest = design.residual - design.columns @ self.theta
        parts = [design.columns, rest[:, :, None], self._drift_columns(design)]
        pose = slice(self.machine, self.about.size)
        whitener = design.whiten(self.about.noise)
        return _Block(cells, design, whitener, np.concatenate(parts, axis=2), pose)

    def _shift(
        self, design: DesignMatrix, rest: Float64[np.ndarray, "n 3"], cells: slice
    ) -> float:
        """Return the gain of a shift of one line, by itself."""
        own = replace(
            design,
            observations=design.observations.select(np.r_[cells]),
            frame=design.frame[cells],
            rows=design.rows[cells],
        )
        timing = own.timing.any(axis=(0, 1))
        kept = np.concatenate([np.ones(own.fixed + 1, bool), timing])
        own = replace(own, rows=own.rows[:, :, kept])
        P = own.columns[:, :, self.machine : self.machine + 3]
        weighted = weigh(own, own.whiten(self.about.noise), P).reshape(-1, 3)
        F = P.reshape(-1, 3).T @ weighted
        pulled = rest[cells].reshape(-1) @ weighted
        return float(np.sum(compute_score(F[None], F[None], pulled[None])[1] ** 2))

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
        self, sums: Sequence[StepSums], drift: Drift
    ) -> tuple[Prospects, Callable[[int], Prospects], Callable[[int], Shared]]:
        """Return steps all over the Run, those from one to the next, what they share.

        sums : of steps, by block
        """
        later = [sums[k + 1 :] for k in range(len(sums))]
        whole = [each.go_on(more) for each, more in zip(sums, later, strict=True)]
        # A step before all cells is a matter of the pose.
        steps = drift.prepare(StepSums.join(whole).select(slice(1, None)))
        ends = np.append(self.starts[1:], len(self.seen))

        @lru_cache(maxsize=2)
        def build(first: int, last: int) -> _Block:
            return self._build(slice(first, last))

        @cache
        def near(k: int) -> Prospects:
            cells = np.arange(ends[k], ends[k + 1], dtype=np.int64)
            found: list[StepSums] = []
            for block, more in zip(self._cut(), later, strict=True):
                inside = cells[(cells >= block.start) & (cells < block.stop)]
                if len(inside):
                    own = build(block.start, block.stop).sum_steps(inside)
                    found.append(own.go_on(more))
            return drift.prepare(StepSums.join(found))

        @cache
        def share(cell: int) -> Shared:
            blocks = list(self._cut())
            number = next(k for k, each in enumerate(blocks) if cell < each.stop)
            block = build(blocks[number].start, blocks[number].stop)
            own = sum((each.own[0] for each in later[number]), np.zeros((6, 6)))
            return Shared(block.cells.start, block.share_step(cell) + own)

        return steps, near, share


def compute_step_limit(lines: int) -> float:
    """Return the gain of a step that chance seldom makes in so many lines."""
    return float(chdtri(6, _RISK / max(lines, 1))) * _STEP_MARGIN


def collect_known(fit: Fit, number: int) -> Information:
    """Return what is known of the machine without one of the Runs."""
    others = [r for k, r in enumerate(fit.runs) if k != number]
    prior = Information.of_matrix(fit.prior.precision_matrix(fit.model.size))
    return add_information(
        [fit.known.add_to(prior, fit.model), *(r.own.eliminate() for r in others)]
    )


def limit_noise(noise: NoiseModel) -> NoiseModel:
    """Return the noise, of which more than is usual is for a test to show."""
    beam, across = noise.ou
    return replace(
        noise,
        ou=(min(beam, _MOST_OU), min(across, _MOST_OU)),
        ou_time_s=min(noise.ou_time_s, _LONGEST_OU_S),
    )


def raise_noise(noise: NoiseModel) -> NoiseModel:
    """Return the noise as loud as is usual: few lines do not tell how loud it is."""
    return replace(noise, ou=(_MOST_OU, _MOST_OU), ou_time_s=_LONGEST_OU_S)


def _count_untimed(design: DesignMatrix, about: Linearisation) -> int:
    """Return of how many cells only what is across the travel counts."""
    seen = design.observations
    moves = seen.direction.any(axis=1)
    return int((moves & (seen.is_ramp | (not about.has_timing))).sum())


def weigh(
    design: DesignMatrix, whitener: Whitener, columns: Float64[np.ndarray, "n 3 p"]
) -> Float64[np.ndarray, "n 3 p"]:
    """Return V⁻¹ columns, the timing of the lines taken out."""
    timing, weighted = design.fit_timing(whitener, columns)
    return whitener.apply(columns) - weighted @ timing


def explain_timing(
    design: DesignMatrix, whitener: Whitener, rest: Float64[np.ndarray, "n 3"]
) -> Float64[np.ndarray, "n 3"]:
    """Return what the timing of the lines explains."""
    timing, _ = design.fit_timing(whitener, rest[:, :, None])
    return (design.timing @ timing)[:, :, 0]


def _cell_squares(
    design: DesignMatrix, rest: Float64[np.ndarray, "n 3"], noise: NoiseModel
) -> Float64[np.ndarray, " n"]:
    """Return the square of each cell by itself, in units of its noise."""
    precision = total_precision(design.observations, noise, design.travel)
    return np.einsum("ni,nij,nj->n", rest, precision, rest)


def invert(
    F: Float64[np.ndarray, "p p"], raw: Float64[np.ndarray, " p"]
) -> Float64[np.ndarray, "p p"]:
    """Return the inverse of what the fit leaves of information on columns.

    raw : that before; directions of which the fit explains all have none
    """
    scale = np.where(raw > 0.0, 1.0 / np.sqrt(np.maximum(raw, 1e-300)), 0.0)
    value, vector = np.linalg.eigh(F * scale[:, None] * scale)
    seen = value > UNSEEN
    inverse = np.where(seen, 1.0 / np.where(seen, value, 1.0), 0.0)
    return (vector * inverse) @ vector.T * scale[:, None] * scale
