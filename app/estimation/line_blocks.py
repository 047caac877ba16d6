"""The base of one line, whitened, the timing of the line taken out of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.estimation.design_matrix import DesignMatrix
from app.estimation.elimination import orthonormalise, project_out
from app.estimation.run_data import RunData
from app.estimation.whitening import WhitenedBlocks, whiten
from app.numerics.correlated_noise import Whitener


@dataclass(frozen=True)
class Line:
    """One line or standstill: what whitens its columns, and its base.

    run, cells : where its cells are
    timing : phase and speed, orthonormal, as far as the data determine them
    base : machine, poses, data; freedom : observations less phase and speed
    log_determinant : of its noise, and of its timing
    """

    run: int
    cells: slice
    design: DesignMatrix
    whitener: Whitener
    timing: WhitenedBlocks
    base: WhitenedBlocks
    freedom: float
    log_determinant: float

    def whiten(self, columns: Float64[np.ndarray, "n 3 p"]) -> WhitenedBlocks:
        """Return columns of this line's cells as they count."""
        own = np.matmul(self.design.frame, columns)
        return project_out(WhitenedBlocks.build(self.whitener, own), self.timing)


def build_line(data: RunData, run: int, first: int, last: int) -> Line:
    """Return one line or standstill of a Run, ready to whiten columns.

    run : which of the Runs; first, last : its first cell, and one past its last
    """
    design = data.base.build(data.observations.select(np.arange(first, last)))
    whitener = whiten(design, data.base.noise)
    blocks = WhitenedBlocks.build(whitener, design.rows)
    base = slice(design.fixed + 1)
    timing, log_timing = orthonormalise(blocks.select(slice(base.stop, None)))
    is_across = not data.base.has_timing and design.observations.at.line[0] >= 0
    return Line(
        run,
        slice(first, last),
        design,
        whitener,
        timing,
        project_out(blocks.select(base), timing),
        (2.0 if is_across else 3.0) * (last - first) - timing.width,
        whitener.log_determinant + log_timing,
    )
