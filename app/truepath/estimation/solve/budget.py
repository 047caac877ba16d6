"""The uncertainty budget of an estimate: variance by source, adding up exactly.

With the pose held, the posterior precision of θ is A + K + P: information of the cells,
of an earlier measurement on known effects, and of the prior. Its covariance C splits
into

    C = C A C + C K C + C P C,

and the first part further, by the propagation of each source of noise through the
estimator G = C JᵀV⁻¹ (JCGM 100, 5.1.2):

    G Vₛ Gᵀ = −C (∂A/∂s) C,    V(s) = V + s Vₛ.

A is homogeneous of degree −1 in all noise variances together, so the parts of white
noise, of correlated noise and of motion along the travel add up to C A C. Solving the
pose from the same data adds the rest of the covariance of a perfect tracker, and its
systematic errors add what exceeds that. The uncertainty of the prior, with all that
hides between knots, adds the estimate's uncertainty beyond its posterior.

The contribution of each of several Runs is the uncertainty with it and without it:
information adds, so that of a Run is subtracted under the same prior and noise.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from truepath.errors import Unidentifiable
from truepath.estimation.problem.direction import Fit
from truepath.estimation.problem.information import compute_posterior
from truepath.estimation.problem.noise import NoiseModel
from truepath.estimation.problem.normal_equations import (
    RunInformation,
    combine_runs,
    compute_under,
)
from truepath.estimation.solve.batch import Estimate
from truepath.kinematics.effects.instrument import is_tracker_error
from truepath.kinematics.model import EstimatedModel
from truepath.kinematics.volumetric_map import (
    compute_component_grams,
    compute_volumetric_gram,
)

SOURCES = (
    "tracker",
    "air",
    "motion",
    "alignment",
    "instrument",
    "thermal",
    "effects",
    "model",
)
"""White noise of the tracker; correlated noise; what moves along the travel and on
ramps; pose and seats; what the tracker and its knowledge of the air may be off by;
thermal effects, and others, known before; prior and knots."""

_THERMAL = frozenset({"thermal-growth", "spindle-growth"})
_KNOWN = 1e9  # precision of a parameter of size 1: as good as fixed
_NEGLECTED = 1e-3  # of the volumetric variance
_STEP = 1e-3  # of a variance: small against it, large against rounding


@dataclass(frozen=True, slots=True)
class UncertaintyBudget:
    """Variances of the volumetric error, mean over the travel, by source and direction.

    variance_mm2 : (s, 3), in the order of `SOURCES`, in x, y, z of the workpiece frame
    """

    variance_mm2: Float64[np.ndarray, "s 3"]


def split_uncertainty(
    estimate: Estimate, settled: EstimatedModel | None = None
) -> UncertaintyBudget:
    """Budget of an estimate that has kept its fit.

    settled : the same estimate with the common scale of all lengths
    Raises Unidentifiable if the data do not determine the machine.
    """
    fit = estimate.stored_fit
    grams = compute_component_grams(estimate.model)
    variance = _split_variance(fit, estimate.covariance, grams)
    if settled is not None:
        more = settled.covariance - estimate.covariance
        variance[SOURCES.index("instrument")] += _contract(more[None], grams)[0]
    return UncertaintyBudget(variance)


def _contract(
    parts: Float64[np.ndarray, "s p p"], grams: Float64[np.ndarray, "3 p p"]
) -> Float64[np.ndarray, "s 3"]:
    return np.einsum("spq,kpq->sk", parts, grams, optimize=True)


def _split_variance(
    fit: Fit,
    stated: Float64[np.ndarray, "p p"],
    grams: Float64[np.ndarray, "3 p p"],
) -> Float64[np.ndarray, "s 3"]:
    size = fit.model.size
    held = np.sum([run.data.matrix[:size, :size] for run in fit.runs], axis=0)
    known = _split_known_precisions(fit)
    prior = fit.prior.precision_matrix(size)
    tracker = [
        fit.model.slices[effect.name]
        for effect in filter(is_tracker_error, fit.model.effects)
    ]
    perfect, free = prior.copy(), fit.result.covariance
    for part in tracker:
        perfect[part, part] += _KNOWN * np.eye(part.stop - part.start)
    if tracker:
        free = compute_posterior(fit.data, perfect).covariance
    data = replace(fit.data, matrix=held + known.sum(axis=0))
    C = compute_posterior(data, perfect).covariance
    before = [C @ precision @ C for precision in known]
    instrument = fit.result.covariance - free
    model = stated - fit.result.covariance + C @ perfect @ C
    parts = _contract(
        np.array([C @ held @ C, free - C, instrument, *before, model]), grams
    )
    return np.concatenate([_split_noise(fit.runs, C, grams, parts[0]), parts[1:]])


def _split_noise(
    runs: Sequence[RunInformation],
    C: Float64[np.ndarray, "p p"],
    grams: Float64[np.ndarray, "3 p p"],
    total: Float64[np.ndarray, "3"],
) -> Float64[np.ndarray, "3 3"]:
    noises = [run.noise for run in runs]
    if all(np.isinf(n.along_sigma_mm) and not n.ramp_sigma_mm for n in noises):
        (white,) = _propagate(runs, C, grams, [_scale_white])
        return np.array([white, total - white, np.zeros_like(total)])
    scales = [_scale_white, _scale_correlated]
    white, correlated = _propagate(runs, C, grams, scales)
    return np.array([white, correlated, total - white - correlated])


def _split_known_precisions(fit: Fit) -> Float64[np.ndarray, "2 p p"]:
    size, known = fit.model.size, fit.known
    whole = np.zeros((size, size))
    part = known.locate(fit.model)
    whole[part, part] = known.precision_matrix()
    is_thermal = np.zeros(size, bool)
    for effect in known.effects:
        is_thermal[fit.model.slices[effect.name]] = effect.family in _THERMAL
    thermal = whole * np.outer(is_thermal, is_thermal)
    return np.array([thermal, whole - thermal])


def _scale_white(noise: NoiseModel, factor: float) -> NoiseModel:
    beam, across = noise.white
    x, y, z = noise.place
    place = (x * factor, y * factor, z * factor)
    return replace(noise, white=(beam * factor, across * factor), place=place)


def _scale_correlated(noise: NoiseModel, factor: float) -> NoiseModel:
    beam, azimuth, elevation = noise.ou
    ou = (beam * factor, azimuth * factor, elevation * factor)
    return replace(noise, ou=ou)


def _propagate(
    runs: Sequence[RunInformation],
    C: Float64[np.ndarray, "p p"],
    grams: Float64[np.ndarray, "3 p p"],
    scales: Sequence[Callable[[NoiseModel, float], NoiseModel]],
) -> Float64[np.ndarray, "s 3"]:
    """Of −C (∂A/∂s) C by each source; 1 + s makes it exact for a single source.

    With C = K Kᵀ and the eigenvectors U of Σ Kᵀ Gₖ K, the directions K U carry the
    volumetric variance one by one: few of them carry all but a thousandth.
    """
    size, K = len(C), np.linalg.cholesky(C)
    seen = K.T @ grams @ K
    carried, vectors = np.linalg.eigh(seen.sum(axis=0))
    least = _NEGLECTED * float(carried.sum())
    U = vectors[:, np.count_nonzero(np.cumsum(carried) < least) :]
    along, weight = K @ U, U.T @ seen @ U
    change = np.zeros((len(scales), *weight.shape[1:]))
    for run in runs:
        louder = [scale(run.noise, (1.0 + _STEP) ** 0.5) for scale in scales]
        found = compute_under(run.observations, run.linearisation, louder, along=along)
        before = along.T @ run.data.matrix[:size, :size] @ along
        change += [before - f.matrix for f in found]
    return _contract(change * (1.0 + _STEP) / _STEP, weight)


@dataclass(frozen=True, slots=True)
class Contributions:
    """Uncertainties of the volumetric error, root mean square over the travel, k = 1.

    sigma_mm : of the estimate; without_mm : without each original Run; infinite where
        the others do not determine the machine, empty for a single Run
    """

    sigma_mm: float
    without_mm: tuple[float, ...]


def compute_contributions(
    estimate: Estimate, given: Sequence[int], settled: EstimatedModel | None = None
) -> Contributions:
    """Contribution of each Run to an estimate that has kept its fit.

    given : for each Run of the estimate, the number of the original Run
    settled : the same estimate with the common scale of all lengths
    """
    fit = estimate.stored_fit
    gram = compute_volumetric_gram(estimate.model)
    own_mm = float(np.sum(gram * estimate.covariance)) ** 0.5
    total = (settled or estimate).covariance
    common_mm2 = float(np.sum(gram * (total - estimate.covariance)))
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
