"""Contribution of each of several Runs: the uncertainty with it, and without it.

Information adds, so that of a Run is subtracted under the same prior and noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from truepath.errors import Unidentifiable
from truepath.estimation.problem.direction import Fit
from truepath.estimation.problem.information import compute_posterior
from truepath.estimation.problem.runs import combine_runs
from truepath.estimation.solve.batch import Estimate
from truepath.kinematics.model import EstimatedModel
from truepath.kinematics.volumetric_map import compute_volumetric_gram


@dataclass(frozen=True, slots=True)
class Contributions:
    """Uncertainties of the volumetric error, root mean square over the travel, k = 1.

    sigma_mm : of the estimate; without_mm : without each original Run; infinite where
        the others do not determine the machine, empty for a single Run
    """

    sigma_mm: float
    without_mm: tuple[float, ...]


def find_contributions(
    estimate: Estimate, given: Sequence[int], settled: EstimatedModel | None = None
) -> Contributions:
    """Contribution of each Run to an estimate that has kept its fit.

    given : for each Run of the estimate, the number of the original Run
    settled : the same estimate with the common scale of all lengths
    """
    fit = estimate.fit
    assert fit is not None  # noqa: S101 (it was asked to be kept)
    gram = compute_volumetric_gram(estimate.model)
    own_mm = float(np.sum(gram * estimate.covariance)) ** 0.5
    told = (settled or estimate).covariance
    common_mm2 = float(np.sum(gram * (told - estimate.covariance)))
    sigma_mm = (own_mm**2 + common_mm2) ** 0.5
    number = len(set(given))
    if number < 2:
        return Contributions(sigma_mm, ())
    every = _predict_residual_mm(fit, range(len(given)))
    without = [
        _predict_residual_mm(
            fit, [k for k, source in enumerate(given) if source != left_out]
        )
        for left_out in range(number)
    ]
    without_mm = (
        max((own_mm * one / every) ** 2 + common_mm2, 0.0) ** 0.5 for one in without
    )
    return Contributions(sigma_mm, tuple(without_mm))


def _predict_residual_mm(fit: Fit, runs: Sequence[int]) -> float:
    data = fit.known.add_to(combine_runs([fit.runs[k] for k in runs]), fit.model)
    precision = fit.prior.precision_matrix(fit.model.size)
    try:
        covariance = compute_posterior(data, precision).covariance
    except Unidentifiable:
        return np.inf
    gram = compute_volumetric_gram(fit.model)
    return float(np.sum(gram * covariance)) ** 0.5
