"""The information form of a linear Gaussian problem (brunn-hanebeck-2005, eq. 31–33).

Information adds: that of all cells is the sum over cells, and the prior is one more
term. Parameters of a single Run or line have no prior: integrating them out loses
nothing for the others (a Schur complement; Golub & Van Loan, Matrix Computations,
3.2.11), and the problem grows neither with the lines nor with the Runs. A parameter
without information keeps its value.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64

from truepath.errors import Unidentifiable
from truepath.numerics.scaled_cholesky import ScaledCholesky

EXACTLY = 1e-8  # mm, rad, s: nothing is known better than to rounding
_SAME = 1e-9  # of the largest eigenvalue of a correlation matrix: rounding
_NEGLIGIBLE = 1e-20  # of the largest information on a parameter: rounding


@dataclass(frozen=True, slots=True)
class Information:
    """AᵀV⁻¹A, AᵀV⁻¹y and yᵀV⁻¹y of the data, with log det V."""

    matrix: Float64[np.ndarray, "p p"]
    vector: Float64[np.ndarray, " p"]
    square: float
    log_determinant: float

    @staticmethod
    def from_total(
        total: Float64[np.ndarray, "q q"],
        log_determinant: float = 0.0,
        columns: Int64[np.ndarray, " p"] | slice = slice(-1),
    ) -> Information:
        """From products of columns and data, the data last; on selected columns."""
        return Information(
            total[columns][:, columns],
            total[columns, -1],
            float(total[-1, -1]),
            log_determinant,
        )

    def select(
        self, columns: Int64[np.ndarray, " p"] | Bool[np.ndarray, " q"]
    ) -> Information:
        return Information(
            self.matrix[columns][:, columns],
            self.vector[columns],
            self.square,
            self.log_determinant,
        )

    @staticmethod
    def nothing(size: int) -> Information:
        return Information.of_matrix(np.zeros((size, size)))

    @staticmethod
    def of_matrix(matrix: Float64[np.ndarray, "p p"]) -> Information:
        """Information with mean 0, as of a prior."""
        return Information(matrix, np.zeros(len(matrix)), 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Posterior:
    """Mean and covariance of θ, with the terms of the evidence.

    misfit : (y − Aθ)ᵀV⁻¹(y − Aθ) + θᵀPθ; log_determinant : of the posterior precision
    """

    theta: Float64[np.ndarray, " p"]
    covariance: Float64[np.ndarray, "p p"]
    misfit: float
    log_determinant: float


def add_information(parts: Sequence[Information]) -> Information:
    return Information(
        np.sum([part.matrix for part in parts], axis=0),
        np.sum([part.vector for part in parts], axis=0),
        sum(part.square for part in parts),
        sum(part.log_determinant for part in parts),
    )


def compute_posterior(
    data: Information, prior_precision: Float64[np.ndarray, "p p"]
) -> Posterior:
    """Posterior from data and prior.

    Raises Unidentifiable if neither determines some direction of θ.
    """
    precision = data.matrix + prior_precision
    if not (np.diag(precision) > 0.0).all():
        raise Unidentifiable("a parameter has neither data nor prior; use more lines")
    try:
        factor = ScaledCholesky.of(precision)
    except np.linalg.LinAlgError as error:
        raise Unidentifiable(
            "the lines do not determine all error motions even with the prior; add "
            "lines in other directions"
        ) from error
    theta = factor.solve(data.vector)
    return Posterior(
        theta,
        factor.invert(),
        data.square - float(data.vector @ theta),
        factor.log_determinant,
    )


def invert_covariance(
    covariance: Float64[np.ndarray, "p p"],
) -> Float64[np.ndarray, "p p"]:
    """Precision of parameters of different units.

    Combinations known exactly are taken as known to `EXACTLY`.
    """
    own = np.sqrt(np.maximum(np.diag(covariance), 0.0) + EXACTLY**2)
    value, vector = np.linalg.eigh(covariance / own[:, None] / own)
    floor = _SAME * float(value.max(initial=1.0))
    inverse = (vector / np.maximum(value, floor)) @ vector.T
    return inverse / own[:, None] / own


def find_informative(square: Float64[np.ndarray, " r"]) -> Int64[np.ndarray, " k"]:
    """Indices of the parameters with information above rounding."""
    return np.flatnonzero(square > _NEGLIGIBLE * square.max(initial=0.0))


@dataclass(frozen=True, slots=True)
class OwnParameters:
    """The last parameters of an information, to be eliminated: those of one Run.

    coupling : (r, k) B, with the parameters before them; vector : (r,)
    factor : of D, their information
    """

    data: Information
    coupling: Float64[np.ndarray, "r k"]
    vector: Float64[np.ndarray, " r"]
    factor: ScaledCholesky

    @staticmethod
    def of(data: Information, kept: int) -> OwnParameters:
        """Splits off all but the first `kept` parameters.

        Raises Unidentifiable if the data do not determine them.
        """
        matrix, vector = data.matrix[kept:].copy(), data.vector[kept:].copy()
        D = matrix[:, kept:]
        unknown = np.ones(len(D), bool)
        unknown[find_informative(np.diag(D))] = False
        matrix[unknown], vector[unknown], D[:, unknown] = 0.0, 0.0, 0.0
        D[unknown, unknown] = 1.0
        try:
            return OwnParameters(data, matrix[:, :kept], vector, ScaledCholesky.of(D))
        except np.linalg.LinAlgError as error:
            raise Unidentifiable(
                "the pose of the tracker or the timing of a line is not determined; "
                "use longer lines in different directions"
            ) from error

    def eliminate(self) -> Information:
        data, kept = self.data, self.coupling.shape[1]
        half = self.factor.solve_half(self.coupling)
        right = self.factor.solve_half(self.vector)
        return Information(
            data.matrix[:kept, :kept] - half.T @ half,
            data.vector[:kept] - half.T @ right,
            data.square - float(right @ right),
            data.log_determinant + self.factor.log_determinant,
        )

    def compute_coupling(self) -> Float64[np.ndarray, "r k"]:
        """D⁻¹B: decrease of these parameters for a unit increase of those before."""
        return self.factor.solve(self.coupling)

    def restore(
        self, known: Posterior
    ) -> tuple[Float64[np.ndarray, " p"], Float64[np.ndarray, "r r"]]:
        """All parameters, with the covariance of these, from those before.

        The reverse of `eliminate`.
        """
        follow = self.compute_coupling()
        theta = self.factor.solve(self.vector) - follow @ known.theta
        covariance = self.factor.invert() + follow @ known.covariance @ follow.T
        return np.concatenate([known.theta, theta]), covariance
