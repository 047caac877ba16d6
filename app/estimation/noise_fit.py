"""Find the noise of every Run from the Runs themselves.

500 Hz samples are correlated in time; who counts them as independent states intervals
that hold the truth far too seldom. The white part is what samples scatter about their
cell. The slow part, its correlation time and the jitter of the feed maximise the
evidence of the whole problem, so that what the error motions take up is accounted for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float64
from scipy.optimize import minimize

from app.alignment.observations import Observations
from app.errors import Unidentifiable
from app.estimation.direction import with_half_widths
from app.estimation.identifiable import identifiable_model
from app.estimation.information import added, information, posterior, without_rest
from app.estimation.noise import NoiseModel
from app.estimation.prior import BendingPrior, evidence_cost, first_guess, fitted
from app.estimation.problem import Problem, coarser
from app.estimation.runs import Measured, Share, shares_of, together, with_noise
from app.kinematics.machine import Machine

_MERGED_S = 0.25  # longer than this the slow part changes within a merged cell
# Knots for judging noise: fine enough that shapes of the errors do not pass for noise.
_COARSE_MM = 35.0
_CELLS = 1000  # as many tell the noise to a few parts in a hundred
_FEWEST_ROWS = 24
_JITTER_FLOOR_MM = 2e-5  # far below any tracker's noise: no jitter
# Few data say little of the slow part; most trackers in most halls are like this.
_USUAL = np.log([0.15, 0.15, 1.0])  # beam, across (of the stated noise), time in s
_USUAL_SPREAD = 1.2
_BOUNDS = np.log([[1e-3, 3.0], [1e-3, 3.0], [0.02, 60.0], [1e-6, 0.1]])


def first_noise(seen: Observations, *, perpendicular_only: bool) -> NoiseModel:
    """Return the tracker's noise with the scatter of this Run and a usual slow part."""
    white = (float(seen.scatter[0]), float(seen.scatter[1]))
    along = np.inf if perpendicular_only or not seen.passes else 2e-4
    return NoiseModel(white, (0.1, 0.1), 1.0, along)


def fit_noise(machine: Machine, runs: Sequence[Measured]) -> tuple[Measured, ...]:
    """Return the Runs with the noise of greatest evidence, starting from theirs.

    Every Run has a noise of its own; what the error motions are, all Runs tell.
    """
    offsets_mm = [run.seen.at.offset_mm for run in runs]
    model, _ = identifiable_model(machine, *offsets_mm, knot_spacing_mm=_COARSE_MM)
    model = with_half_widths(model)  # lost motion must not pass for slow noise
    few = [replace(run, seen=_some_lines(run.seen)) for run in runs]
    shares = shares_of(few, model)
    prior, result = fitted(together(shares), first_guess(model))
    small: list[Share] = []
    for run, share in zip(runs, shares, strict=True):
        problem = coarser(share.problem, _merge(run.seen))
        theta, _ = share.completed(result)
        cost = _residual_cost(problem, theta)
        small.append(
            with_noise(problem, _minimised(cost, run.noise, step=0.7, calls=80))
        )
    for k, share in enumerate(small):
        cost = _evidence_cost(share.problem, prior, small[:k] + small[k + 1 :])
        noise = _minimised(cost, share.noise, step=0.3, calls=30)
        small[k] = with_noise(share.problem, noise)
    return tuple(
        replace(run, noise=share.noise) for run, share in zip(runs, small, strict=True)
    )


def residual_noise(
    problem: Problem, theta: Float64[np.ndarray, " p"], noise: NoiseModel
) -> NoiseModel:
    """Return the noise that the residuals of an estimate show.

    Quick, for the live estimate: what the estimate has taken up of it is not counted.
    """
    small = coarser(problem, _merge(problem.seen))
    return _minimised(_residual_cost(small, theta), noise, step=0.7, calls=60)


def _some_lines(seen: Observations) -> Observations:
    """Return whole lines or standstills, evenly spread, that make enough cells."""
    rows = np.unique(seen.row)
    cells = len(seen) / _merge(seen)
    keep = max(_FEWEST_ROWS, int(len(rows) * min(1.0, _CELLS / cells)))
    if keep >= len(rows):
        return seen
    kept = rows[np.linspace(0, len(rows) - 1, keep).round().astype(np.int64)]
    return seen.taken(np.flatnonzero(np.isin(seen.row, kept)))


def _merge(seen: Observations) -> int:
    """Return how many cells make a stretch that is still short for the slow part."""
    length = float(np.median(seen.count)) / seen.at.machine.tracker.rate_hz
    return max(1, round(_MERGED_S / length))


def _residual_cost(
    problem: Problem, theta: Float64[np.ndarray, " p"]
) -> Callable[[NoiseModel], float]:
    """Return −2 log p(residuals): quick, but blind to what the model has taken up."""
    left = problem.rows[:, :, -1:] - problem.rows[:, :, :-1] @ theta[:, None]
    bare = replace(problem, rows=left)

    def cost(noise: NoiseModel) -> float:
        data = information(bare, noise)
        return data.log_determinant + data.square

    return cost


def _evidence_cost(
    problem: Problem, prior: BendingPrior, others: Sequence[Share]
) -> Callable[[NoiseModel], float]:
    """Return −2 log p(data), the prior's strengths and the other Runs' noise held."""
    size = prior.model.size
    precision = prior.precision(size)
    known = [share.about_machine for share in others]

    def cost(noise: NoiseModel) -> float:
        data = without_rest(information(problem, noise), size)
        data = added([data, *known])
        return evidence_cost(data, prior, posterior(data, precision))

    return cost


def _minimised(
    cost: Callable[[NoiseModel], float], noise: NoiseModel, *, step: float, calls: int
) -> NoiseModel:
    start = _packed(noise)
    bounds = _BOUNDS[: len(start)]

    def bounded(x: Float64[np.ndarray, " k"]) -> float:
        inside = np.clip(x, bounds[:, 0], bounds[:, 1])
        penalty = 1e3 * float(np.sum((x - inside) ** 2))
        try:
            return cost(_unpacked(inside, noise)) + penalty + _surprise(inside)
        except (Unidentifiable, np.linalg.LinAlgError):
            return np.inf

    simplex = np.vstack([start, start + step * np.eye(len(start))])
    found = minimize(
        bounded,
        start,
        method="Nelder-Mead",
        options={
            "initial_simplex": simplex,
            "maxfev": calls,
            "xatol": 0.05,
            "fatol": 0.5,
        },
    )
    best = np.asarray(found.x, np.float64)
    return _unpacked(np.clip(best, bounds[:, 0], bounds[:, 1]), noise)


def _surprise(x: Float64[np.ndarray, " k"]) -> float:
    """Return −2 log of how usual the slow part is."""
    return float(np.sum((x[:3] - _USUAL) ** 2)) / _USUAL_SPREAD**2


def _packed(noise: NoiseModel) -> Float64[np.ndarray, " k"]:
    known = [*noise.slow, noise.slow_time_s]
    if np.isfinite(noise.along_sigma_mm):
        known.append(max(noise.along_sigma_mm, _JITTER_FLOOR_MM))
    return np.log(known)


def _unpacked(x: Float64[np.ndarray, " k"], noise: NoiseModel) -> NoiseModel:
    beam, across, tau, *jitter = (float(v) for v in np.exp(x))
    along = noise.along_sigma_mm
    if jitter:
        along = jitter[0] if jitter[0] > _JITTER_FLOOR_MM else 0.0
    return NoiseModel(noise.white, (beam, across), tau, along)
