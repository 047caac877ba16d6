"""All observations of all Runs at once: errors, poses, timing and noise together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from app.alignment.observations import Observations
from app.estimation.direction import best_fit
from app.estimation.estimate import Estimate, Residuals, RunEstimate
from app.estimation.extrapolation import measured_ranges, with_ends_free
from app.estimation.identifiable import identifiable_model
from app.estimation.information import Posterior
from app.estimation.noise import NoiseModel
from app.estimation.noise_fit import first_noise, fit_noise
from app.estimation.observability import observability
from app.estimation.prior import first_guess, fitted, with_unknown_strengths
from app.estimation.problem import Problem, refined_pose
from app.estimation.runs import Measured, Share, shares_of, together
from app.measurement.one_machine import one_machine


def estimate(
    *observed: Observations,
    perpendicular_only: bool = False,
    keep_fit: bool = False,
    progress: Callable[[float], None] | None = None,
    names: Sequence[str] = (),
) -> Estimate:
    """Estimate all error motions that the observations can tell.

    observed : of one Run each, in either mode
    perpendicular_only : leave out what is measured along the travel (sanders-2023)
    keep_fit : keep what the estimate was solved from, for trials by Monte Carlo
    progress : told the share done, 0 to 1
    names : of the Runs, for errors and for targets that need a name

    Raises Unidentifiable if the lines do not determine the error motions, BundleError
    if the Runs are not of one machine.
    """
    told = progress or _untold
    machine = one_machine(
        [seen.at.machine for seen in observed], _named(names, observed)
    )
    model, _ = identifiable_model(machine, *(seen.at.offset_mm for seen in observed))
    runs = tuple(
        Measured(
            _of_run(seen, k),
            seen.pose,
            first_noise(seen, perpendicular_only=perpendicular_only),
        )
        for k, seen in enumerate(observed)
    )
    shares = shares_of(runs, model)
    _, result = fitted(together(shares), first_guess(model))
    told(0.2)
    # The rough pose is off by the machine's errors: linearise about the better one.
    runs = fit_noise(machine, [_better(s, result) for s in shares])
    told(0.7)
    fit = with_ends_free(best_fit(runs, model))
    observable = observability(machine, runs)
    told(0.9)
    told(1.0)
    result = with_unknown_strengths(fit.prior, fit.result)
    return Estimate(
        fit.model,
        result.theta,
        result.covariance,
        fit.prior.strength,
        observable,
        fit.direction,
        perpendicular_only,
        tuple(_of_one(share, result) for share in fit.shares),
        measured_ranges(*observed),
        fit if keep_fit else None,
    )


def _untold(share: float) -> None:
    """Tell nobody."""


def _named(names: Sequence[str], observed: Sequence[Observations]) -> Sequence[str]:
    return names or [f"Run {number}" for number in range(1, len(observed) + 1)]


def _of_run(seen: Observations, run: int) -> Observations:
    return replace(seen, at=replace(seen.at, run=run))


def _better(share: Share, machine: Posterior) -> Measured:
    theta, _ = share.completed(machine)
    problem = share.problem
    return Measured(problem.seen, refined_pose(problem, theta), share.noise)


def _of_one(share: Share, machine: Posterior) -> RunEstimate:
    theta, covariance = share.completed(machine)
    problem, seen = share.problem, share.problem.seen
    return RunEstimate(
        share.noise,
        refined_pose(problem, theta),
        covariance[:6, :6],  # the pose comes first of what is the Run's own
        seen.at.point_mm.mean(axis=0),
        seen.at.machine.tracker,
        float(np.linalg.norm(seen.tracker_mm, axis=1).mean()),
        _residuals(problem, theta, share.noise),
        len(seen),
        seen.used,
        seen.offered,
        len(np.unique(seen.row)),
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
