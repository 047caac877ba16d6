"""All lines of all Runs with the parts common to every fit, in folds of whole lines.

Each line is whitened alone, its phase and speed integrated out: so sums over some lines
give the information without the others, and no sample is read again.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Float64

from truepath.alignment.observations.observations import Observations
from truepath.discovery.terms.line_blocks import (
    Line,
    RunData,
    WhitenedBlocks,
    build_line,
    place_run,
)
from truepath.estimation.checks.intra_cell_motion import CellDeviations
from truepath.estimation.noise.baseline import Baseline
from truepath.estimation.problem.prior import diagonal_precision
from truepath.files.bundle.run import Run
from truepath.kinematics.effects.base import Effect

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
        """Columns of effects on all lines, side by side."""
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
    pairs = zip(runs, observations, strict=True)
    return FoldedLines([place_run(run, seen, baseline) for run, seen in pairs])
