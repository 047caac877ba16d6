"""Predicted motion of the target by a result, and the poses of the tracker given it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from truepath.alignment.observations.observations import Observations
from truepath.errors import Unidentifiable
from truepath.estimation.noise.noise_fit import guess_noise, refine_runs
from truepath.estimation.problem.noise import assume_typical_noise
from truepath.estimation.problem.prior_effects import (
    PriorEffects,
    extract_prior_effects,
)
from truepath.estimation.problem.runs import RunInput
from truepath.files.earlier.result_file import CalibrationResult
from truepath.kinematics.coarse_model import build_run_models
from truepath.kinematics.conditions import Conditions
from truepath.kinematics.model import MachineModel
from truepath.kinematics.volumetric_map import compute_second_order_mm
from truepath.results.lost_motion import compute_lost_motion_mm

_ROUNDS, _SAME_NOISE = 6, 0.01  # three or four settle it to a hundredth

Correction = Callable[[Conditions], Float64[np.ndarray, "n 3"]]
"""Correction by a controller at the conditions of cells, mm."""


def predict_displacement(
    result: CalibrationResult, at: Conditions, correction: Correction | None = None
) -> Float64[np.ndarray, "n 3"]:
    """Displacement from nominal, by errors of the machine and the controller.

    Lost motion counts by the direction that each axis came from.
    """
    moved = result.model.displacement_mm(at, result.theta)
    moved = moved + compute_lost_motion_mm(result, at)
    moved = moved + compute_second_order_mm(result.model, at, result.theta)
    return moved if correction is None else moved + correction(at)


def find_poses(
    result: CalibrationResult,
    parts: Sequence[Observations],
    correction: Correction | None,
) -> Sequence[RunInput]:
    """Pose and noise of each part, whatever its machine is.

    The noise is estimated next to a machine whose errors are free, so that errors of
    the result do not count as noise. The prediction is subtracted first: no noise is
    lost to the free errors either.
    """
    known = extract_prior_effects(
        result.model, np.zeros(result.model.size), result.covariance
    ).inflate_covariance()
    models = build_run_models(
        result.machine, [part.at for part in parts], known.effects
    )
    starts = [_take_off(result, part, correction) for part in parts]
    try:
        return _settle_noise(models.coarse, starts, known)
    except Unidentifiable:  # too few points: typical noise
        return [replace(one, noise=assume_typical_noise(one.noise)) for one in starts]


def _take_off(
    result: CalibrationResult, part: Observations, correction: Correction | None
) -> RunInput:
    """Residual of a part after the prediction, with its rough pose."""
    moved = predict_displacement(result, part.at, correction)
    rest = replace(part, tracker_mm=part.tracker_mm - moved @ part.pose.rotation.T)
    return RunInput(rest, part.pose, guess_noise(part, perpendicular_only=False))


def _settle_noise(
    model: MachineModel, starts: Sequence[RunInput], known: PriorEffects
) -> Sequence[RunInput]:
    """Alternate between the noise and the variance of the machine's free errors.

    By a noise that is too low, some of it passes for error of the free machine, which
    the next noise then lacks: few points cannot distinguish them, so both are found in
    turn.
    """
    found: Sequence[RunInput] = starts
    for _ in range(_ROUNDS):
        before = [
            replace(start, pose=one.pose, noise=one.noise)
            for start, one in zip(starts, found, strict=True)
        ]
        found = refine_runs(model, before, known=known)
        now, last = (
            [(*one.noise.ou, *one.noise.place) for one in runs]
            for runs in (found, before)
        )
        if np.allclose(now, last, rtol=_SAME_NOISE, atol=0.0):
            break
    return found
