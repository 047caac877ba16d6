"""The data that terms are fitted to, line by line: whitened, timing eliminated.

With V the covariance of white and Ornstein–Uhlenbeck noise, aᵀ V⁻¹ b is a product of
two whitened columns, each less its part in the eliminated parameters. They are computed
once and then give products with any other column.

Each line is whitened alone, its phase and speed integrated out: so sums over some lines
give the information without the others, and no sample is read again. Cross-validation
has folds of whole lines.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float64, Int64

from truepath.alignment.observations.observations import Observations
from truepath.estimation.checks.intra_cell_motion import (
    CellDeviations,
    compute_cell_deviations,
)
from truepath.estimation.noise.baseline import Baseline, replace_pose
from truepath.estimation.problem.design_matrix import DesignMatrix, Linearisation
from truepath.estimation.problem.information import find_informative
from truepath.estimation.problem.prior import diagonal_precision
from truepath.files.bundle.run import Run
from truepath.kinematics.conditions import Conditions
from truepath.kinematics.effects.base import Effect
from truepath.numerics.correlated_noise import Whitener


@dataclass(frozen=True)
class WhitenedBlocks:
    """Columns on lines, one line after another: aᵀ V⁻¹ b is the product of two.

    rows : (m, p); begin : (l + 1,) first row of each line, and one past the last
    """

    rows: Float64[np.ndarray, "m p"]
    begin: Int64[np.ndarray, " l"]

    @staticmethod
    def of_line(rows: Float64[np.ndarray, "m p"]) -> WhitenedBlocks:
        return WhitenedBlocks(rows, np.array([0, len(rows)]))

    @staticmethod
    def join(lines: Sequence[WhitenedBlocks]) -> WhitenedBlocks:
        """Concatenates lines, in the order given."""
        rows = [line.rows for line in lines]
        begin = np.cumsum([0, *(len(each) for each in rows)])
        return WhitenedBlocks(np.concatenate(rows), begin)

    @staticmethod
    def stack(columns: Sequence[WhitenedBlocks]) -> WhitenedBlocks | None:
        """Columns on the same lines side by side; None for no columns."""
        if not columns:
            return None
        rows = np.concatenate([one.rows for one in columns], axis=1)
        return WhitenedBlocks(rows, columns[0].begin)

    @property
    def width(self) -> int:
        return self.rows.shape[1]

    def select(self, own: slice | Int64[np.ndarray, " k"]) -> WhitenedBlocks:
        """Some of the columns, in Fortran order."""
        return WhitenedBlocks(np.asfortranarray(self.rows[:, own]), self.begin)

    def between(self, first: int, last: int) -> WhitenedBlocks:
        """Consecutive lines from `first` up to `last`, exclusive."""
        begin = self.begin[first : last + 1]
        return WhitenedBlocks(self.rows[begin[0] : begin[-1]], begin - begin[0])

    def multiply(self, other: WhitenedBlocks) -> Float64[np.ndarray, "p q"]:
        """Products of these columns with others, on the same lines."""
        return self.rows.T @ other.rows

    def squares(self) -> Float64[np.ndarray, " p"]:
        return np.einsum("mp,mp->p", self.rows, self.rows)


@dataclass(frozen=True)
class RunData:
    """Cells of a Run, with the tracker's pose of the baseline.

    base : machine, poses and noise common to all fits
    within : samples within the cells, where fast effects show
    """

    observations: Observations
    base: Linearisation
    within: CellDeviations | None = None


@dataclass(frozen=True)
class Line:
    """One line or standstill, with the whitening of its columns.

    run, cells : number of the Run and its cells
    timing : phase and speed, orthonormal, as far as the data determine them
    freedom : observations less phase and speed
    log_determinant : of its noise, and of its timing
    """

    run: int
    cells: slice
    design: DesignMatrix
    whitener: Whitener
    timing: WhitenedBlocks
    freedom: float
    log_determinant: float

    def whiten(self, columns: Float64[np.ndarray, "n 3 p"]) -> WhitenedBlocks:
        """Whitened columns of this line's cells, timing removed."""
        return _project_out(self._whiten(columns), self.timing)

    def find_timing(
        self, columns: Float64[np.ndarray, "n 3 p"]
    ) -> Float64[np.ndarray, "t p"]:
        """What orthonormal phase and speed take of the whitened columns."""
        return self.timing.multiply(self._whiten(columns))

    def _whiten(self, columns: Float64[np.ndarray, "n 3 p"]) -> WhitenedBlocks:
        own = np.matmul(self.design.frame, columns)
        return WhitenedBlocks.of_line(self.whitener.whiten(own))


PlacedLine = tuple[Line, WhitenedBlocks]
"""A line with its machine, poses and data."""


def build_line(data: RunData, run: int, first: int, last: int) -> PlacedLine:
    """One line or standstill of a Run, and its machine, poses and data.

    run : number of the Run; first, last : its first cell, and one past its last
    """
    design = data.base.build(data.observations.select(np.arange(first, last)))
    whitener = design.whiten(data.base.noise)
    blocks = WhitenedBlocks.of_line(whitener.whiten(design.rows))
    base = slice(design.fixed + 1)
    timing, log_timing = _orthonormalise(blocks.select(slice(base.stop, None)))
    moves = design.observations.at.line >= 0
    is_across = design.observations.is_ramp | (moves & (not data.base.has_timing))
    line = Line(
        run,
        slice(first, last),
        design,
        whitener,
        timing,
        3.0 * (last - first) - float(is_across.sum()) - timing.width,
        whitener.log_determinant + log_timing,
    )
    return line, _project_out(blocks.select(base), timing)


def _orthonormalise(timing: WhitenedBlocks) -> tuple[WhitenedBlocks, float]:
    """Orthonormal timing of a line, and the log determinant.

    Undetermined columns are dropped.
    """
    timing = timing.select(find_informative(timing.squares()))
    factor = np.linalg.cholesky(timing.multiply(timing))
    inverse = np.linalg.inv(factor).T
    log_determinant = 2.0 * float(np.log(np.diag(factor)).sum())
    return WhitenedBlocks.of_line(timing.rows @ inverse), log_determinant


def _project_out(columns: WhitenedBlocks, timing: WhitenedBlocks) -> WhitenedBlocks:
    taken = timing.rows @ timing.multiply(columns)
    return WhitenedBlocks.of_line(columns.rows - taken)


@dataclass(frozen=True)
class Residual:
    """Residual of a Run, mm, in the frame that the tracker is mounted on.

    residual_mm, weighted : (n, 3) r and V⁻¹ r, phase and speed of each line taken out
    precision : (n, 3, 3) of the white noise
    ou, ou_time_s : density of the Ornstein–Uhlenbeck noise over that of the white noise
        at frequency 0, and its correlation time
    within : samples within their cells, where fast effects show as well
    """

    at: Conditions
    residual_mm: Float64[np.ndarray, "n 3"]
    weighted: Float64[np.ndarray, "n 3"]
    precision: Float64[np.ndarray, "n 3 3"]
    ou: float
    ou_time_s: float
    within: CellDeviations | None = None

    def ou_density(
        self, frequency_hz: Float64[np.ndarray, " f"]
    ) -> Float64[np.ndarray, " f"]:
        """Density of the Ornstein–Uhlenbeck noise over the white noise's."""
        angle = 2.0 * np.pi * frequency_hz * self.ou_time_s
        return self.ou / (1.0 + angle**2)


def weight_residual(
    data: RunData,
    lines: Sequence[Line],
    effects: Sequence[Effect],
    theta: Float64[np.ndarray, " p"],
) -> Residual:
    """Measured minus machine, pose and effects.

    lines : of this Run; theta : of machine and poses, then of the effects
    """
    seen, base = data.observations, data.base
    residual_mm, weighted = np.zeros((2, len(seen), 3))
    precision = np.zeros((len(seen), 3, 3))
    moved = _displacement_mm(seen.at, effects, theta[base.size :])
    for line in lines:
        design, frame = line.design, line.design.frame
        rest = design.residual - design.columns @ theta[: base.size]
        rest = (rest - np.einsum("nij,nj->ni", frame, moved[line.cells]))[:, :, None]
        late, timing = design.fit_timing(line.whitener, rest)
        solved = line.whitener.apply(rest) - timing @ late
        rest = rest - design.timing @ late
        weighted[line.cells] = np.einsum("nij,nik->nj", frame, solved)
        residual_mm[line.cells] = np.einsum("nij,nik->nj", frame, rest)
        root = np.matmul(line.whitener.root, frame)
        precision[line.cells] = np.matmul(np.swapaxes(root, 1, 2), root)
    noise, rate_hz = base.noise, seen.at.machine.tracker.rate_hz
    ratio = np.mean(np.square(noise.ou)) / np.mean(np.square(noise.white))
    return Residual(
        seen.at,
        residual_mm,
        weighted,
        precision,
        float(ratio) * 2.0 * noise.ou_time_s * rate_hz,
        noise.ou_time_s,
        data.within,
    )


def _displacement_mm(
    at: Conditions, effects: Sequence[Effect], theta: Float64[np.ndarray, " q"]
) -> Float64[np.ndarray, "n 3"]:
    ends = np.cumsum([0, *(len(effect.parameters) for effect in effects)])
    moved = np.zeros((len(at), 3))
    for effect, (first, last) in zip(effects, pairwise(ends), strict=True):
        moved += effect.jacobian(at) @ theta[first:last]
    return moved


FOLDS = 8  # of lines, each held out once
_POSE = {"mm": 1.0, "rad": 1e-3}  # standard uncertainty of a tracker's pose
_FEWEST_LINES = 2  # in each fold, of a further Run that is held out


class FoldedLines:
    """All lines of all Runs with their base: machine, poses and data.

    Line k belongs to fold k modulo the number of folds, so that neighbours in time are
    in different folds. A further Run of few lines is held out nowhere: without one of
    them the pose of its tracker would be unknown.

    lines, base : fold after fold, those never held out last; ground : products of the
        base over each fold; freedom : of each fold that is held out
    within : samples within the cells of each Run, and whether they are held out
    """

    def __init__(self, runs: Sequence[RunData]) -> None:
        self.runs = tuple(runs)
        self.size = runs[0].base.size
        self.within: list[tuple[CellDeviations, bool]] = []
        lines: list[tuple[int, Line, WhitenedBlocks]] = []
        for number, data in enumerate(runs):
            parts = data.observations.lines
            is_held = number == 0 or len(parts) >= _FEWEST_LINES * FOLDS
            for k, (first, last) in enumerate(parts):
                line = build_line(data, number, first, last)
                lines.append((k % FOLDS if is_held else FOLDS, *line))
            if data.within is not None:
                self.within.append((data.within, is_held))
        fold = np.array([fold for fold, _, _ in lines])
        order = np.argsort(fold, kind="stable")
        self.lines = [lines[int(k)][1] for k in order]
        self._bounds = np.searchsorted(fold[order], np.arange(FOLDS + 2))
        free = np.array([line.freedom for line in self.lines])
        self.freedom = np.bincount(fold[order], free, FOLDS + 1)[:FOLDS]
        self.log_determinant = float(sum(line.log_determinant for line in self.lines))
        self.base = WhitenedBlocks.join([lines[int(k)][2] for k in order])
        self.ground = self.multiply(self.base, self.base)

    @property
    def pose_precision(self) -> Float64[np.ndarray, "b b"]:
        """Prior of the poses, around those that alignment found."""
        base = self.runs[0].base
        poses = diagonal_precision(base.pose_parameters, _POSE)
        return np.pad(poses, (base.machine_model.size, 0))

    def of(self, run: int) -> list[Line]:
        """Lines of one Run, in the order of the folds."""
        return [line for line in self.lines if line.run == run]

    def whiten(self, effects: Sequence[Effect]) -> WhitenedBlocks:
        rows = self._jacobians(effects)
        return WhitenedBlocks.join(
            [line.whiten(rows[line.run][line.cells]) for line in self.lines]
        )

    def sum_timing(self, effects: Sequence[Effect]) -> list[Float64[np.ndarray, "p p"]]:
        """What phase and speed of each line take of the information of each effect."""
        if not effects:
            return []
        ends = np.cumsum([0, *(len(e.parameters) for e in effects)]).tolist()
        total = np.zeros((ends[-1], ends[-1]))
        rows = self._jacobians(effects)
        for line in self.lines:
            taken = line.find_timing(rows[line.run][line.cells])
            total += taken.T @ taken
        return [total[a:b, a:b] for a, b in pairwise(ends)]

    def _jacobians(
        self, effects: Sequence[Effect]
    ) -> list[Float64[np.ndarray, "n 3 p"]]:
        return [
            np.concatenate([e.jacobian(data.observations.at) for e in effects], axis=2)
            for data in self.runs
        ]

    def about(self, run: int, time_s: float) -> list[int]:
        """Numbers of the line of a Run at a moment, and of its neighbours in time."""
        clock_s = self.runs[run].observations.at.time_s
        lines = [(n, line) for n, line in enumerate(self.lines) if line.run == run]
        begins = sorted((float(clock_s[line.cells.start]), n) for n, line in lines)
        here = max(int(np.searchsorted([t for t, _ in begins], time_s)) - 1, 0)
        return [n for _, n in begins[max(here - 1, 0) : here + 2]]

    def edges_s(self, number: int) -> Float64[np.ndarray, " e"]:
        """Times of a line's cells, and of the last one before it."""
        line = self.lines[number]
        time_s = self.runs[line.run].observations.at.time_s
        return time_s[max(line.cells.start - 1, 0) : line.cells.stop]

    def multiply(
        self, one: WhitenedBlocks, other: WhitenedBlocks
    ) -> Float64[np.ndarray, "f p q"]:
        """oneᵀ V⁻¹ other over each fold, then over the lines never held out."""
        bounds = zip(self._bounds, self._bounds[1:], strict=False)
        return np.stack(
            [one.between(*ends).multiply(other.between(*ends)) for ends in bounds]
        )


def build_lines(
    runs: Sequence[Run], observations: Sequence[Observations], baseline: Baseline
) -> FoldedLines:
    """The lines of all Runs with pose and noise of the baseline.

    observations : of each Run, in fine cells
    """
    placed: list[RunData] = []
    for run, seen in zip(runs, observations, strict=True):
        base = baseline.linearise(seen.at.run)
        seen = replace_pose(seen, base.pose)
        placed.append(RunData(seen, base, compute_cell_deviations(run, seen, base)))
    return FoldedLines(placed)
