"""All observations of all Runs at once: errors, poses, timing and noise together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from app.alignment.observations import Observations
from app.estimation.direction import best_fit
from app.estimation.estimate import Estimate, Residuals, RunEstimate
from app.estimation.extrapolation import measured_ranges, with_ends_free
from app.estimation.information import Posterior
from app.estimation.known_effects import KnownEffects
from app.estimation.noise import NoiseModel, floor_mm, whiten
from app.estimation.noise_fit import first_noise, looked_at
from app.estimation.observability import observability
from app.estimation.prior import widen_by_unknown_precision
from app.estimation.problem import Part, Problem, refined_pose
from app.estimation.runs import Measured, Share
from app.files.one_machine import one_machine
from app.kinematics.identifiable import identifiable_model
from app.progress import ShareProgress, ignore_progress


def estimate(
    *observed: Observations,
    known: KnownEffects | None = None,
    perpendicular_only: bool = False,
    keep_fit: bool = False,
    on_progress: ShareProgress = ignore_progress,
    names: Sequence[str] = (),
) -> Estimate:
    """Estimate all error motions that the observations can tell.

    observed : of one Run each, in either mode; with surroundings where effects are
        known that depend on them
    known : effects that an earlier measurement has told, to be estimated beside
    perpendicular_only : leave out what is measured along the travel (sanders-2023)
    keep_fit : keep what the estimate was solved from, for trials by Monte Carlo
    on_progress : receives the share done, 0 to 1
    names : of the Runs, for errors and for targets that need a name

    Raises Unidentifiable if the lines do not determine the error motions, BundleError
    if the Runs are not of one machine.
    """
    known = known or KnownEffects()
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
    runs = looked_at(machine, runs, known=known)
    on_progress(0.5)
    fit = with_ends_free(best_fit(runs, known.beside(model), known))
    on_progress(0.9)
    observable = observability(machine, runs)
    result = widen_by_unknown_precision(fit.prior, fit.result)
    made = Estimate(
        fit.model,
        result.theta,
        result.covariance,
        fit.prior.precision,
        observable,
        fit.direction,
        perpendicular_only,
        tuple(_of_one(share, result) for share in fit.shares),
        measured_ranges(*observed),
        known,
        known.chances(fit.model, fit.result),
        fit if keep_fit else None,
    )
    on_progress(1.0)
    return made


def _named(names: Sequence[str], observed: Sequence[Observations]) -> Sequence[str]:
    return names or [f"Run {number}" for number in range(1, len(observed) + 1)]


def _of_run(seen: Observations, run: int) -> Observations:
    return replace(seen, at=replace(seen.at, run=run))


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
    parts = [(_left(part, theta, noise), _along(part)) for part in problem.parts()]
    left, along = (np.concatenate(blocks) for blocks in zip(*parts, strict=True))
    across = left - np.einsum("ni,ni->n", left, along)[:, None] * along
    counted = across if noise.along_sigma_mm == np.inf else left
    return Residuals(
        left,
        np.linalg.norm(across, axis=1),
        seen.row,
        seen.at.position_mm,
        float(np.sqrt(np.mean(counted**2))),
        floor_mm(seen, noise, along),
    )


def _left(
    part: Part, theta: Float64[np.ndarray, " p"], noise: NoiseModel
) -> Float64[np.ndarray, "n 3"]:
    """Return what is left of the data, the timing of each line at its best."""
    left = part.off - part.rows[:, :, : part.data] @ theta
    timing = part.timing
    if not timing.size:
        return left
    told = whiten(part.seen, noise, part.frame).applied(timing)
    H = np.tensordot(told, timing, axes=((0, 1), (0, 1)))
    pull = np.tensordot(told, left, axes=((0, 1), (0, 1)))
    return left - timing @ np.linalg.lstsq(H, pull, rcond=None)[0]


def _along(part: Part) -> Float64[np.ndarray, "n 3"]:
    return np.einsum("nij,nj->ni", part.frame, part.seen.direction)
