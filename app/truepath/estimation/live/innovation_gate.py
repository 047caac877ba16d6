"""New lines of a measurement in progress, compared with the prediction by earlier ones.

So a burst or a moved reflector does not affect the numbers shown. Lines that do not fit
are held back until all lines are examined together (`segment_check`).

The innovation of a line scatters by its noise and by the uncertainty of the estimate: S
= V + A P Aᵀ (Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and
Navigation, 2001, 5.4). Its square for a single cell shows a burst; that of a shift of
the whole line shows that tracker or reflector has moved. Limits are those of the whole
measurement (`robust_estimate`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from truepath.alignment.observations.observations import Observations
from truepath.alignment.stream.left_out import LeftOut
from truepath.estimation.checks.run_segments import (
    MOST,
    SetupShift,
    exclude_cells,
    mark_outliers,
)
from truepath.estimation.checks.score import compute_score
from truepath.estimation.problem.design_matrix import Linearisation
from truepath.estimation.problem.information import Posterior
from truepath.estimation.problem.noise import assume_typical_noise, total_precision


@dataclass(frozen=True, slots=True)
class LiveCheck:
    """State of the data of a measurement in progress.

    left_out : valid samples that are not used
    setup_shifts : at which the Run was split
    used_samples, cells : used for the estimate
    held : rows of the newest lines, which do not fit the earlier ones; held_mm : their
        largest deviation
    residual, white, place : of the fit, of a sample and between places, relative to
        the tracker's specification; place_um : the last in range, azimuth, elevation
    """

    left_out: tuple[LeftOut, ...] = ()
    setup_shifts: tuple[SetupShift, ...] = ()
    used_samples: int = 0
    cells: int = 0
    held: tuple[int, ...] = ()
    held_mm: float = 0.0
    residual: float = 1.0
    white: float = 1.0
    place: float = 0.0
    place_um: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class LineGate:
    """Innovation gate: compares new lines with their prediction.

    squares : of the shifts of accepted lines; cells : tested so far
    held : rows of the newest lines, which were rejected; held_mm : their largest
        deviation
    """

    squares: tuple[float, ...] = ()
    cells: int = 0
    held: tuple[int, ...] = ()
    held_mm: float = 0.0

    def check(
        self, about: Linearisation, predicted: Posterior, line: Observations
    ) -> tuple[LineGate, Observations]:
        """The gate after a line, and the accepted cells of the line."""
        found = compute_innovation(about, predicted, line)
        tested, edges = self.cells + len(line), np.arange(len(line) + 1)
        bad = mark_outliers(found.cell, among=tested)
        if bad.any() and bad.mean() < MOST:
            kept = exclude_cells(line, bad, found.off_mm, edges)
            return self.check(about, predicted, kept) if len(kept) else (self, kept)
        square, reference = np.array([found.line]), np.array(self.squares or (0.0,))
        if not bad.any() and not mark_outliers(square, reference, len(reference))[0]:
            return LineGate((*self.squares, found.line), tested), line
        off_mm = float(found.off_mm.max()) if bad.any() else found.moved_mm
        gate = replace(
            self,
            cells=tested,
            held=tuple(sorted({*self.held, int(line.row[0])})),
            held_mm=max(self.held_mm, off_mm),
        )
        bad = np.ones(len(line), bool)
        return gate, exclude_cells(line, bad, found.off_mm, edges)


@dataclass(frozen=True, slots=True)
class Innovation:
    """Measured minus predicted of one line or standstill.

    cell : (n,) squares of its cells, in units of their variance; off_mm : (n,) their
        size
    line : square of a shift of the whole line, likewise; moved_mm : its size
    """

    cell: Float64[np.ndarray, " n"]
    off_mm: Float64[np.ndarray, " n"]
    line: float
    moved_mm: float


def compute_innovation(
    about: Linearisation, predicted: Posterior, seen: Observations
) -> Innovation:
    """Measured minus predicted of one line or standstill, with S = V + A P Aᵀ.

    predicted : machine and pose from the lines before
    """
    noise = assume_typical_noise(about.noise)
    design = about.build(seen)
    whitener, A = design.whiten(noise), design.columns
    rest = design.residual - A @ predicted.theta
    P, m = predicted.covariance, about.machine_model.size
    shift = A[:, :, m : m + 3]
    weighted = design.weigh(whitener, shift).reshape(-1, 3)
    F = shift.reshape(-1, 3).T @ weighted
    G = weighted.T @ A.reshape(len(weighted), -1)
    pulled = rest.reshape(-1) @ weighted
    root, own = compute_score(F[None], F[None], pulled[None])
    _, score = compute_score((F + G @ P @ G.T)[None], F[None], pulled[None])
    left = rest - design.explain_timing(whitener, rest)
    along = np.where(seen.is_ramp, np.einsum("ni,ni->n", left, design.travel), 0.0)
    left -= along[:, None] * design.travel  # a ramp has no information along the line
    # rᵀ(Λ⁻¹ + A P Aᵀ)⁻¹r of each cell; Λ may be singular.
    precision = total_precision(seen, noise, design.travel)
    spread = (A @ P) @ A.transpose(0, 2, 1)
    whitened = np.linalg.inv(np.eye(3) + precision @ spread)
    pulled = np.einsum("nij,nj->ni", precision, left)
    return Innovation(
        np.einsum("ni,nij,nj->n", left, whitened, pulled),
        np.linalg.norm(left, axis=1),
        float(np.sum(score**2)),
        float(np.linalg.norm(root[0] @ own[0])),
    )
