"""The information form of a linear Gaussian problem (brunn-hanebeck-2005, eq. 31–33).

Information adds: that of all cells is the sum over cells, and the prior is one more
term.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from app.errors import Unidentifiable
from app.numerics.scaled_cholesky import ScaledCholesky


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
        """Return what products of columns and data, the last, say of some columns."""
        return Information(
            total[columns][:, columns],
            total[columns, -1],
            float(total[-1, -1]),
            log_determinant,
        )

    @staticmethod
    def of_matrix(matrix: Float64[np.ndarray, "p p"]) -> Information:
        """Return information whose mean is 0, as of a prior."""
        return Information(matrix, np.zeros(len(matrix)), 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Posterior:
    """Mean and covariance of θ, with what the evidence needs.

    misfit : (y − Aθ)ᵀV⁻¹(y − Aθ) + θᵀPθ; log_determinant : of the posterior precision
    """

    theta: Float64[np.ndarray, " p"]
    covariance: Float64[np.ndarray, "p p"]
    misfit: float
    log_determinant: float


def add_information(parts: Sequence[Information]) -> Information:
    """Return the information of independent data on the same parameters."""
    return Information(
        np.sum([part.matrix for part in parts], axis=0),
        np.sum([part.vector for part in parts], axis=0),
        sum(part.square for part in parts),
        sum(part.log_determinant for part in parts),
    )


def compute_posterior(
    data: Information, prior_precision: Float64[np.ndarray, "p p"]
) -> Posterior:
    """Combine data and prior.

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
