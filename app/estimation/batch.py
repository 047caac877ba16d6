"""All observations of all Runs at once: errors, poses, timing and noise together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from app.alignment.observations import Observations
from app.estimation.design_matrix import DesignMatrix
from app.estimation.direction import select_fit
from app.estimation.elimination import fit_timing
from app.estimation.estimate import Estimate, Residuals, RunEstimate
from app.estimation.extrapolation import find_measured_ranges, free_ends
from app.estimation.information import Posterior
from app.estimation.known_effects import KnownEffects
from app.estimation.noise import NoiseModel, floor_mm
from app.estimation.noise_fit import guess_noise, refine_runs
from app.estimation.observability import assess_observability
from app.estimation.prior import widen_by_unknown_precision
from app.estimation.runs import RunInformation, RunInput
from app.estimation.whitening import whiten
from app.files.one_machine import one_machine
from app.kinematics.coarse_model import build_coarse_model
from app.kinematics.identifiable import build_identifiable_model
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
        [each.at.machine for each in observed], _name(names, observed)
    )
    offsets_mm = [each.at.offset_mm for each in observed]
    model, _ = build_identifiable_model(machine, *offsets_mm)
    coarse = build_coarse_model(machine, offsets_mm, known.effects)
    inputs = tuple(
        RunInput(
            replace(each, at=replace(each.at, run=k)),
            each.pose,
            guess_noise(each, perpendicular_only=perpendicular_only),
        )
        for k, each in enumerate(observed)
    )
    inputs = refine_runs(coarse, inputs, known=known)
    on_progress(0.5)
    fit = free_ends(select_fit(inputs, known.extend(model), known))
    on_progress(0.9)
    observability = assess_observability(machine, inputs)
    result = widen_by_unknown_precision(fit.prior, fit.result)
    found = Estimate(
        fit.model,
        result.theta,
        result.covariance,
        fit.prior.precision,
        observability,
        fit.direction,
        perpendicular_only,
        tuple(_estimate_run(run, result) for run in fit.runs),
        find_measured_ranges(*observed),
        known,
        known.compute_chances(fit.model, fit.result),
        fit if keep_fit else None,
    )
    on_progress(1.0)
    return found


def _name(names: Sequence[str], observed: Sequence[Observations]) -> Sequence[str]:
    return names or [f"Run {number}" for number in range(1, len(observed) + 1)]


def _estimate_run(run: RunInformation, machine: Posterior) -> RunEstimate:
    theta, pose_covariance = run.restore_pose(machine)
    observations = run.observations
    return RunEstimate(
        run.noise,
        run.linearisation.correct_pose(theta),
        pose_covariance,
        observations.at.point_mm.mean(axis=0),
        observations.at.machine.tracker,
        float(np.linalg.norm(observations.tracker_mm, axis=1).mean()),
        _compute_residuals(run, theta),
        len(observations),
        observations.used,
        observations.offered,
        len(np.unique(observations.row)),
    )


def _compute_residuals(
    run: RunInformation, theta: Float64[np.ndarray, " p"]
) -> Residuals:
    designs = list(run.linearisation.split(run.observations))
    residual = np.concatenate([_fit_lines(d, theta, run.noise) for d in designs])
    travel = np.concatenate([design.travel for design in designs])
    across = residual - np.einsum("ni,ni->n", residual, travel)[:, None] * travel
    counted = across if run.noise.along_sigma_mm == np.inf else residual
    return Residuals(
        residual,
        np.linalg.norm(across, axis=1),
        run.observations.row,
        run.observations.at.position_mm,
        float(np.sqrt(np.mean(counted**2))),
        floor_mm(run.observations, run.noise, travel),
    )


def _fit_lines(
    design: DesignMatrix, theta: Float64[np.ndarray, " p"], noise: NoiseModel
) -> Float64[np.ndarray, "n 3"]:
    """Return what is left of the data, the timing of each line at its best."""
    left = (design.residual - design.columns @ theta)[:, :, None]
    timing, _ = fit_timing(whiten(design, noise), design.timing, left)
    return (left - design.timing @ timing)[:, :, 0]
