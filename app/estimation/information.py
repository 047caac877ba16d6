"""The information form of a linear Gaussian problem (brunn-hanebeck-2005, eq. 31–33).

Information adds: that of all cells is the sum over cells, and the prior is one more
term.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.linalg import cho_solve, solve_triangular
from scipy.linalg.lapack import dpotri

from app.errors import Unidentifiable
from app.estimation.noise import NoiseModel, whiten
from app.estimation.problem import Problem


@dataclass(frozen=True, slots=True)
class Information:
    """AᵀV⁻¹A, AᵀV⁻¹y and yᵀV⁻¹y of the data, with log det V."""

    matrix: Float64[np.ndarray, "p p"]
    vector: Float64[np.ndarray, " p"]
    square: float
    log_determinant: float


@dataclass(frozen=True, slots=True)
class Posterior:
    """Mean and covariance of θ, with what the evidence needs.

    misfit : (y − Aθ)ᵀV⁻¹(y − Aθ) + θᵀPθ; log_determinant : of the posterior precision
    """

    theta: Float64[np.ndarray, " p"]
    covariance: Float64[np.ndarray, "p p"]
    misfit: float
    log_determinant: float


def information(problem: Problem, noise: NoiseModel) -> Information:
    """Return the information of all cells under a noise model."""
    white, slow = (whitener := whiten(problem.seen, noise, problem.frame)).halves(
        problem.rows
    )
    total = white.T @ white
    if len(slow):
        total -= slow.T @ slow
    return Information(
        total[:-1, :-1],
        total[:-1, -1],
        float(total[-1, -1]),
        whitener.log_determinant,
    )


def posterior(
    data: Information, prior_precision: Float64[np.ndarray, "p p"]
) -> Posterior:
    """Combine data and prior.

    Raises Unidentifiable if neither determines some direction of θ.
    """
    precision = data.matrix + prior_precision
    diagonal = np.diag(precision)
    if not (diagonal > 0.0).all():
        raise Unidentifiable("a parameter has neither data nor prior; use more lines")
    scale = 1.0 / np.sqrt(diagonal)
    try:
        factor = np.linalg.cholesky(precision * scale[:, None] * scale)
    except np.linalg.LinAlgError as error:
        raise Unidentifiable(
            "the lines do not determine all error motions even with the prior; add "
            "lines in other directions"
        ) from error
    theta = scale * cho_solve((factor, True), scale * data.vector)
    lower, _ = dpotri(factor, lower=1)
    inverse = np.tril(lower) + np.tril(lower, -1).T
    return Posterior(
        theta,
        inverse * scale[:, None] * scale,
        data.square - float(data.vector @ theta),
        2.0 * float(np.log(np.diag(factor)).sum() - np.log(scale).sum()),
    )


def without_rest(data: Information, kept: int) -> Information:
    """Return the information on the first parameters, the others integrated out.

    The others have no prior, so this loses nothing for the first.
    Raises Unidentifiable if the data do not determine the others.
    """
    A, B, D = (
        data.matrix[:kept, :kept],
        data.matrix[:kept, kept:],
        data.matrix[kept:, kept:],
    )
    rest = data.vector[kept:]
    scale = 1.0 / np.sqrt(np.diag(D))
    try:
        factor = np.linalg.cholesky(D * scale[:, None] * scale)
    except np.linalg.LinAlgError as error:
        raise Unidentifiable(
            "the pose of the tracker or the timing of a line is not determined; use "
            "longer lines in different directions"
        ) from error
    half = solve_triangular(factor, scale[:, None] * B.T, lower=True)
    right = solve_triangular(factor, scale * rest, lower=True)
    turned = 2.0 * float(np.log(np.diag(factor)).sum() - np.log(scale).sum())
    return Information(
        A - half.T @ half,
        data.vector[:kept] - half.T @ right,
        data.square - float(right @ right),
        data.log_determinant + turned,
    )
