"""All observations at once: machine errors, pose, timing and noise in one estimate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from app.alignment.observations import Observations
from app.estimation.direction import Fit, best_fit
from app.estimation.estimate import Estimate, Observability, Residuals
from app.estimation.extrapolation import measured_ranges, with_ends_free
from app.estimation.identifiable import identifiable_model
from app.estimation.information import information
from app.estimation.noise import NoiseModel
from app.estimation.noise_fit import first_noise, fit_noise
from app.estimation.observability import observability
from app.estimation.prior import first_guess, fitted, with_unknown_strengths
from app.estimation.problem import Problem, pose_problem, refined_pose


def estimate(
    seen: Observations,
    *,
    perpendicular_only: bool = False,
    keep_fit: bool = False,
    progress: Callable[[float], None] | None = None,
) -> Estimate:
    """Estimate all error motions that the observations can tell.

    perpendicular_only : leave out what is measured along the travel (sanders-2023)
    keep_fit : keep what the estimate was solved from, for trials by Monte Carlo
    progress : told the share done, 0 to 1

    Raises Unidentifiable if the lines do not determine the error motions.
    """
    told = progress or _untold
    machine_model, _ = identifiable_model(seen.at.machine, seen.at.offset_mm)
    problem = pose_problem(seen, machine_model, seen.pose)
    noise = first_noise(seen, perpendicular_only=perpendicular_only)
    _, result = fitted(information(problem, noise), first_guess(machine_model))
    told(0.2)
    # The rough pose is off by the machine's errors: linearise about the better one.
    pose = refined_pose(problem, result.theta)
    noise = fit_noise(seen, pose, noise)
    told(0.7)
    fit = with_ends_free(best_fit(seen, machine_model, pose, noise), noise)
    observable = observability(seen, pose, noise)
    told(0.9)
    told(1.0)
    packed = _packed(fit, noise, observable, perpendicular_only)
    return replace(packed, fit=fit) if keep_fit else packed


def _untold(share: float) -> None:
    """Tell nobody."""


def _packed(
    fit: Fit,
    noise: NoiseModel,
    observable: Observability,
    perpendicular_only: bool,
) -> Estimate:
    problem, seen = fit.problem, fit.problem.seen
    result = with_unknown_strengths(fit.prior, fit.result)
    size = problem.machine_model.size
    pose = problem.model.slices["tracker-pose"]
    return Estimate(
        problem.machine_model,
        result.theta[:size],
        result.covariance[:size, :size],
        fit.prior.strength,
        noise,
        refined_pose(problem, result.theta),
        result.covariance[pose, pose],
        seen.at.point_mm.mean(axis=0),
        observable,
        fit.direction,
        _residuals(problem, result.theta, noise),
        perpendicular_only,
        len(seen),
        seen.used,
        seen.offered,
        len(np.unique(seen.row)),
        measured=measured_ranges(seen),
    )


def _residuals(
    problem: Problem, theta: Float64[np.ndarray, " p"], noise: NoiseModel
) -> Residuals:
    seen = problem.seen
    left = problem.rows[:, :, -1] - problem.rows[:, :, :-1] @ theta
    along = np.einsum("nij,nj->ni", problem.frame, seen.direction)
    across = left - np.einsum("ni,ni->n", left, along)[:, None] * along
    counted = across if noise.along_sigma_mm == np.inf else left
    return Residuals(
        left,
        np.linalg.norm(across, axis=1),
        seen.row,
        seen.at.position_mm,
        float(np.sqrt(np.mean(counted**2))),
        _floor_mm(problem, noise, along),
    )


def _floor_mm(
    problem: Problem, noise: NoiseModel, along: Float64[np.ndarray, "n 3"]
) -> float:
    """Return the root mean square of one residual component that noise alone makes."""
    seen = problem.seen
    distance = np.linalg.norm(seen.tracker_mm, axis=1)
    stated = seen.at.machine.tracker.sigma_mm(distance)[:, [0, 1, 1]]
    white = stated * np.array([noise.white[0], noise.white[1], noise.white[1]])
    slow = stated * np.array([noise.slow[0], noise.slow[1], noise.slow[1]])
    variance = white**2 / seen.count[:, None] + slow**2
    if noise.along_sigma_mm == np.inf:
        variance = variance * (1.0 - along**2)
    else:
        variance = variance + noise.along_sigma_mm**2 * along**2
    return float(np.sqrt(np.mean(variance)))
