"""Error parameters as a straight line in temperature, from several results.

Result k gives θₖ with its covariance Cₖ at a temperature that is t_k from the
reference, known to u_k:

    θₖ = a + b tₖ + eₖ,   cov eₖ = D Cₖ D + b bᵀ uₖ²

a and b follow by generalised least squares over all parameters at once; b bᵀ uₖ² is the
effect of the thermometer's error on a machine that depends on temperature (effective
variance, Orear 1982), found by a few iterations. D widens each effect by the scatter of
results about the line beyond their uncertainties: set-ups, and everything else that is
not temperature. Its square is the ratio of Birge (1932), here the mean over an effect's
table of Σₖ rₖ² / var rₖ; it is never below 1. That it is known from n − 2 results only
enters by the effective degrees of freedom ν of Welch and Satterthwaite (GUM, G.4.1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.special import stdtrit

from truepath.numerics.scaled_cholesky import ScaledCholesky

_ROUNDS = 4
_ROUNDING = 1e-9  # of a variance: matrices from files are regular to that
_COVERAGE = 0.975  # one side, of k = 1.96
_NORMAL = 1.959964


@dataclass(frozen=True, slots=True)
class TableRows:
    """Entries of one effect's table: rows times its parameters.

    part : slice of the parameters
    """

    name: str
    part: slice
    rows: Float64[np.ndarray, "m k"]


@dataclass(frozen=True, slots=True)
class Scatter:
    """Scatter of results about a course, relative to their uncertainties.

    ratio : mean square over a table of residuals over their standard uncertainty;
        `constant_ratio` about a mean instead of the line
    freedom : effective degrees of freedom ν of the widened uncertainty
    """

    ratio: float
    constant_ratio: float
    freedom: float

    @property
    def widening(self) -> float:
        return float(np.sqrt(max(self.ratio, 1.0)))

    @property
    def coverage(self) -> float:
        """Further factor, so that k = 2 still covers 95 %."""
        if not np.isfinite(self.freedom):
            return 1.0
        return float(stdtrit(self.freedom, _COVERAGE)) / _NORMAL


@dataclass(frozen=True)
class TemperatureLine:
    """Value at the reference and change per kelvin, of all parameters.

    covariance : of both, the values first; includes the scatter, not its coverage
        factor
    scatter : of each effect by name
    """

    value: Float64[np.ndarray, " p"]
    per_kelvin: Float64[np.ndarray, " p"]
    covariance: Float64[np.ndarray, "q q"]
    scatter: dict[str, Scatter]


def fit_temperature_line(
    theta: Float64[np.ndarray, "n p"],
    covariance: Float64[np.ndarray, "n p p"],
    offset_k: Float64[np.ndarray, " n"],
    sigma_k: Float64[np.ndarray, " n"],
    tables: Sequence[TableRows],
) -> TemperatureLine:
    """Generalised least squares over all results.

    theta, covariance : of each result, n >= 3
    offset_k : temperature less the reference; sigma_k : its standard uncertainty

    Raises LinAlgError where a covariance is singular, or all temperatures are equal.
    """
    ridge = np.einsum("npp->np", covariance) * _ROUNDING
    regular = covariance + ridge[:, :, None] * np.eye(theta.shape[1])
    line = _solve(theta, regular, offset_k, sigma_k)
    scatter = {
        one.name: _measure_scatter(one, theta, regular, offset_k, sigma_k, line[1])
        for one in tables
    }
    widening = np.ones(theta.shape[1])
    for one in tables:
        widening[one.part] = scatter[one.name].widening
    widened = regular * widening[:, None] * widening
    return TemperatureLine(*_solve(theta, widened, offset_k, sigma_k), scatter)


def _solve(
    theta: Float64[np.ndarray, "n p"],
    covariance: Float64[np.ndarray, "n p p"],
    offset_k: Float64[np.ndarray, " n"],
    sigma_k: Float64[np.ndarray, " n"],
) -> tuple[
    Float64[np.ndarray, " p"], Float64[np.ndarray, " p"], Float64[np.ndarray, "q q"]
]:
    """a, b and their joint covariance."""
    count = theta.shape[1]
    b = np.zeros(count)
    solved, inverse = np.zeros(2 * count), np.zeros((2 * count, 2 * count))
    for _ in range(_ROUNDS if sigma_k.any() else 1):
        normal, right = np.zeros_like(inverse), np.zeros(2 * count)
        for k, own in enumerate(covariance):
            weight = ScaledCholesky.of(own + np.outer(b, b) * sigma_k[k] ** 2).invert()
            powers = np.array([1.0, offset_k[k]])
            normal += np.kron(np.outer(powers, powers), weight)
            right += np.outer(powers, weight @ theta[k]).ravel()
        factor = ScaledCholesky.of(normal)
        solved, inverse = factor.solve(right), factor.invert()
        b = solved[count:]
    return solved[:count], b, inverse


def _measure_scatter(
    table: TableRows,
    theta: Float64[np.ndarray, "n p"],
    covariance: Float64[np.ndarray, "n p p"],
    offset_k: Float64[np.ndarray, " n"],
    sigma_k: Float64[np.ndarray, " n"],
    per_kelvin: Float64[np.ndarray, " p"],
) -> Scatter:
    rows, part = table.rows, table.part
    value = theta[:, part] @ rows.T
    slope = rows @ per_kelvin[part]
    own = covariance[:, part, part]
    variance = np.einsum("mk,nkl,ml->nm", rows, own, rows)
    known = variance.min(axis=0) > _ROUNDING * variance.max(initial=0.0)
    value, variance = value[:, known], variance[:, known]
    variance = variance + np.outer(sigma_k**2, slope[known] ** 2)
    flat = np.ones((len(theta), 1))
    line = np.column_stack([flat, offset_k])
    ratio, constant = (_compute_ratio(value, variance, form) for form in (line, flat))
    beyond = max(ratio - 1.0, 0.0)
    freedom = (len(theta) - 2) * (ratio / beyond) ** 2 if beyond else np.inf
    return Scatter(ratio, constant, float(freedom))


def _compute_ratio(
    value: Float64[np.ndarray, "n m"],
    variance: Float64[np.ndarray, "n m"],
    form: Float64[np.ndarray, "n f"],
) -> float:
    """Mean over entries of Σ r² / var per degree of freedom."""
    freedom = len(value) - form.shape[1]
    if not value.size:
        return 0.0
    weight = 1.0 / np.sqrt(variance.T)
    whitened, shape = value.T * weight, form * weight[:, :, None]
    right: Float64[np.ndarray, "m f"] = np.einsum("mnf,mn->mf", shape, whitened)
    normal: Float64[np.ndarray, "m f f"] = np.einsum("mnf,mng->mfg", shape, shape)
    found = np.linalg.solve(normal, right[:, :, None])[:, :, 0]
    left = whitened - np.einsum("mnf,mf->mn", shape, found)
    return float(np.sum(left**2)) / (freedom * value.shape[1])
