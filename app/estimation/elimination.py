"""Parameters that one Run or one line has for itself, taken out of the problem.

Phase and speed belong to the cells of one line, the pose of the tracker to one Run.
They have no prior, so integrating them out loses nothing for what remains (a Schur
complement; Golub & Van Loan, Matrix Computations, 3.2.11), and the problem's size grows
neither with the lines nor with the Runs. A parameter of which the data say nothing is
left where it is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from app.errors import Unidentifiable
from app.estimation.design_matrix import DesignMatrix
from app.estimation.information import Information, Posterior
from app.estimation.whitening import WhitenedBlocks
from app.numerics.correlated_noise import (
    OrnsteinUhlenbeckState,
    Whitener,
    eliminate_columns,
)
from app.numerics.scaled_cholesky import ScaledCholesky

_SILENT = 1e-20  # of the largest information on a parameter: none but rounding
_SAME = 1e-6  # phase and speed of a line of one cell are the same


def find_informative(square: Float64[np.ndarray, " r"]) -> Int64[np.ndarray, " k"]:
    """Return the parameters of which the data say anything at all."""
    return np.flatnonzero(square > _SILENT * square.max(initial=0.0))


def eliminate_timing(
    total: Float64[np.ndarray, "q q"], state: OrnsteinUhlenbeckState | None, fixed: int
) -> tuple[Float64[np.ndarray, "k k"], float, OrnsteinUhlenbeckState | None]:
    """Integrate the timing out of products over fixed parameters, data, timing.

    Returns them, what the log determinant gains, and the state of the correlated noise.
    Raises Unidentifiable if the timing of a line is not determined.
    """
    kept = fixed + 1
    timing = kept + find_informative(np.diag(total)[kept:])
    try:
        return eliminate_columns(total, state, np.arange(kept), timing)
    except np.linalg.LinAlgError as error:
        raise Unidentifiable(
            "the timing of a line is not determined; use longer lines"
        ) from error


@dataclass(frozen=True, slots=True)
class OwnParameters:
    """The last parameters of one Run's information, which it has for itself.

    coupling : (r, k) B, with the parameters before them; vector : (r,)
    factor : of D, their own information
    """

    data: Information
    coupling: Float64[np.ndarray, "r k"]
    vector: Float64[np.ndarray, " r"]
    factor: ScaledCholesky

    @staticmethod
    def of(data: Information, kept: int) -> OwnParameters:
        """Split off all but the first parameters.

        Raises Unidentifiable if the data do not determine them.
        """
        matrix, vector = data.matrix[kept:].copy(), data.vector[kept:].copy()
        D = matrix[:, kept:]
        silent = np.ones(len(D), bool)
        silent[find_informative(np.diag(D))] = False
        matrix[silent], vector[silent], D[:, silent] = 0.0, 0.0, 0.0
        D[silent, silent] = 1.0
        try:
            return OwnParameters(data, matrix[:, :kept], vector, ScaledCholesky.of(D))
        except np.linalg.LinAlgError as error:
            raise Unidentifiable(
                "the pose of the tracker or the timing of a line is not determined; "
                "use longer lines in different directions"
            ) from error

    def eliminate(self) -> Information:
        """Return the information on the parameters before, these integrated out."""
        data, kept = self.data, self.coupling.shape[1]
        half = self.factor.solve_half(self.coupling)
        right = self.factor.solve_half(self.vector)
        return Information(
            data.matrix[:kept, :kept] - half.T @ half,
            data.vector[:kept] - half.T @ right,
            data.square - float(right @ right),
            data.log_determinant + self.factor.log_determinant,
        )

    def follow(self) -> Float64[np.ndarray, "r k"]:
        """Return D⁻¹B: how far they go against those before, to follow the data."""
        return self.factor.solve(self.coupling)

    def restore(
        self, known: Posterior
    ) -> tuple[Float64[np.ndarray, " p"], Float64[np.ndarray, "r r"]]:
        """Return all parameters where those before are known.

        And the covariance of these. The reverse of `eliminate`.
        """
        follow = self.follow()
        theta = self.factor.solve(self.vector) - follow @ known.theta
        covariance = self.factor.invert() + follow @ known.covariance @ follow.T
        return np.concatenate([known.theta, theta]), covariance


def fit_timing(
    whitener: Whitener,
    timing: Float64[np.ndarray, "n 3 t"],
    columns: Float64[np.ndarray, "n 3 p"],
) -> tuple[Float64[np.ndarray, "t p"], Float64[np.ndarray, "n 3 t"]]:
    """Return phase and speed that explain columns best, and V⁻¹ timing."""
    own = whitener.apply(timing)
    if not timing.size:
        return np.zeros((timing.shape[2], columns.shape[2])), own
    H = np.tensordot(own, timing, axes=((0, 1), (0, 1)))
    pull = np.tensordot(own, columns, axes=((0, 1), (0, 1)))
    return np.linalg.lstsq(H, pull, rcond=None)[0], own


def orthonormalise(timing: WhitenedBlocks) -> tuple[WhitenedBlocks, float]:
    """Return the timing of a line with products 0 and 1, and the log determinant.

    What the data say nothing of is left out.
    """
    timing = timing.select(find_informative(timing.squares()))
    factor = np.linalg.cholesky(timing.multiply(timing))
    inverse = np.linalg.inv(factor).T
    log_determinant = 2.0 * float(np.log(np.diag(factor)).sum())
    blocks = WhitenedBlocks.of_line(timing.plus @ inverse, timing.minus @ inverse)
    return blocks, log_determinant


def project_out(columns: WhitenedBlocks, timing: WhitenedBlocks) -> WhitenedBlocks:
    """Return the columns of a line less what its orthonormal timing takes away."""
    minus = np.concatenate([columns.minus, timing.multiply(columns)])
    return WhitenedBlocks.of_line(columns.plus, minus)


def project_out_white(
    rows: Float64[np.ndarray, "l m p"], timing: Float64[np.ndarray, "l m t"]
) -> Float64[np.ndarray, "l m p"]:
    """Return whitened rows of many lines less what the timing of each explains."""
    basis, _ = np.linalg.qr(timing)
    return rows - basis @ (np.swapaxes(basis, 1, 2) @ rows)


def select_independent(design: DesignMatrix) -> Float64[np.ndarray, "n 3 p"]:
    """Return columns of all parameters, but of timing only what is independent.

    A line of one cell has a phase, but no speed beside it.
    """
    n, count = len(design.rows), max(len(design.lines), 1)
    timing = design.timing.reshape(n, 3, count, -1)
    gram = np.einsum("nilj,nilk->ljk", timing, timing)
    shows = [
        np.linalg.det(gram[:, :k, :k])
        > _SAME * np.diagonal(gram[:, :k, :k], axis1=1, axis2=2).prod(axis=1)
        for k in range(1, gram.shape[1] + 1)
    ]
    independent = np.stack(shows, axis=1).ravel() if shows else np.zeros(0, bool)
    columns = [design.columns, design.timing[:, :, independent]]
    return np.concatenate(columns, axis=2)
