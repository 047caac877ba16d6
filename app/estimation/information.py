"""The information form of a linear Gaussian problem (brunn-hanebeck-2005, eq. 31–33).

Information adds: that of all cells is the sum over cells, and the prior is one more
term.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64
from scipy.linalg import cho_solve, solve_triangular
from scipy.linalg.lapack import dpotri

from app.errors import Unidentifiable
from app.estimation.noise import NoiseModel, cell_noise
from app.estimation.problem import Part, Problem
from app.numerics.correlated_noise import Tail, extended, without_columns

_SILENT = 1e-20  # of the largest information on a parameter: none but rounding


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
    """Return the information on machine and pose under a noise model.

    Timing of the lines is integrated out. Parts follow one another in time; the slow
    part of the noise goes on from one to the next.
    Raises Unidentifiable if the timing of a line is not determined.
    """
    p = problem.model.size
    total, log_determinant = np.zeros((p + 1, p + 1)), 0.0
    tail: Tail | None = None
    for part in problem.parts():
        gain, log_gain, tail = _with_part(part, noise, tail)
        total += gain
        log_determinant += log_gain
    if tail is not None:
        taken, log_taken = tail.taken()
        total -= taken
        log_determinant += log_taken
    return Information(
        total[:-1, :-1], total[:-1, -1], float(total[-1, -1]), log_determinant
    )


def _with_part(
    part: Part, noise: NoiseModel, tail: Tail | None
) -> tuple[Float64[np.ndarray, "q q"], float, Tail | None]:
    """Return what a part adds to the sums, and its last cell's correlated noise."""
    q, width = part.data + 1, part.rows.shape[2]
    if tail is not None:
        more = np.zeros((3, width - q))
        tail = replace(tail, pulled=np.hstack([tail.pulled, more]))
    precision, ou = cell_noise(part.seen, noise, part.frame)
    gain, log_gain, tail = extended(
        tail, part.seen.at.time_s, precision, ou, noise.ou_time_s, part.rows
    )
    # A line of one cell says nothing of its speed, which then stays as commanded.
    own = np.diag(gain)[q:]
    told = q + np.flatnonzero(own > _SILENT * own.max(initial=0.0))
    try:
        square, turned, tail = without_columns(gain, tail, np.arange(q), told)
    except np.linalg.LinAlgError as error:
        raise Unidentifiable(
            "the timing of a line is not determined; use longer lines"
        ) from error
    return square, log_gain + turned, tail


def added(parts: Sequence[Information]) -> Information:
    """Return the information of independent data on the same parameters."""
    return Information(
        np.sum([part.matrix for part in parts], axis=0),
        np.sum([part.vector for part in parts], axis=0),
        sum(part.square for part in parts),
        sum(part.log_determinant for part in parts),
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
    if kept == len(data.vector):
        return data
    rest = _rest(data, kept)
    scale, factor = rest.scale[:, None], rest.factor
    half = solve_triangular(factor, scale * rest.matrix[:, :kept], lower=True)
    right = solve_triangular(factor, rest.scale * rest.vector, lower=True)
    turned = 2.0 * float(np.log(np.diag(factor)).sum() - np.log(scale).sum())
    return Information(
        data.matrix[:kept, :kept] - half.T @ half,
        data.vector[:kept] - half.T @ right,
        data.square - float(right @ right),
        data.log_determinant + turned,
    )


def rest_per_first(data: Information, kept: int) -> Float64[np.ndarray, "r k"]:
    """Return D⁻¹Bᵀ: how far the others go against the first, to follow the data."""
    rest = _rest(data, kept)
    return rest.solved(rest.matrix[:, :kept])


def with_rest(
    data: Information, known: Posterior
) -> tuple[Float64[np.ndarray, " p"], Float64[np.ndarray, "r r"]]:
    """Return all parameters where the first are known, and the others' covariance.

    The reverse of `without_rest`: the others follow from the first and their own data.
    """
    kept = len(known.theta)
    rest = _rest(data, kept)
    alone = rest.solved(np.eye(len(rest.vector)))
    turned = rest.solved(rest.matrix[:, :kept])
    theta = alone @ rest.vector - turned @ known.theta
    covariance = alone + turned @ known.covariance @ turned.T
    return np.concatenate([known.theta, theta]), covariance


@dataclass(frozen=True, slots=True)
class _Rest:
    """The others' own information D, factorised.

    matrix : (r, p), their rows of AᵀV⁻¹A
    scale, factor : of the Cholesky factor of D, its diagonal scaled to one
    """

    matrix: Float64[np.ndarray, "r p"]
    vector: Float64[np.ndarray, " r"]
    scale: Float64[np.ndarray, " r"]
    factor: Float64[np.ndarray, "r r"]

    def solved(self, right: Float64[np.ndarray, "r k"]) -> Float64[np.ndarray, "r k"]:
        """Return D⁻¹ times the right side."""
        scale = self.scale[:, None]
        return scale * cho_solve((self.factor, True), scale * right)


def _rest(data: Information, kept: int) -> _Rest:
    matrix, vector = data.matrix[kept:].copy(), data.vector[kept:].copy()
    diagonal = np.diag(matrix[:, kept:])
    silent = diagonal <= _SILENT * diagonal.max()
    matrix[silent], vector[silent] = 0.0, 0.0
    matrix[:, kept:][:, silent] = 0.0
    matrix[silent, kept + np.flatnonzero(silent)] = 1.0
    D = matrix[:, kept:]
    scale = 1.0 / np.sqrt(np.diag(D))
    try:
        factor = np.linalg.cholesky(D * scale[:, None] * scale)
    except np.linalg.LinAlgError as error:
        raise Unidentifiable(
            "the pose of the tracker or the timing of a line is not determined; use "
            "longer lines in different directions"
        ) from error
    return _Rest(matrix, vector, scale, factor)
