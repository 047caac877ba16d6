"""What a result says of the target's motion, and the poses of the tracker beside it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from truepath.alignment.observations.observations import Observations
from truepath.errors import Unidentifiable
from truepath.estimation.noise.noise_fit import guess_noise, refine_runs
from truepath.estimation.problem.known_effects import (
    KnownEffects,
    extract_known_effects,
)
from truepath.estimation.problem.noise import raise_noise
from truepath.estimation.problem.runs import RunInput
from truepath.files.earlier.result_file import CalibrationResult
from truepath.kinematics.coarse_model import build_run_models
from truepath.kinematics.conditions import Conditions
from truepath.kinematics.model import MachineModel
from truepath.kinematics.second_order import compute_second_order_mm
from truepath.results.lost_motion import find_lost_motion_mm

_ROUNDS, _SAME_NOISE = 6, 0.01  # three or four settle it to a hundredth

Correction = Callable[[Conditions], Float64[np.ndarray, "n 3"]]
"""What a controller adds at the conditions of cells, mm."""


def predict_displacement(
    result: CalibrationResult, at: Conditions, correction: Correction | None = None
) -> Float64[np.ndarray, "n 3"]:
    """Return how far off nominal the target is, as errors and controller move it.

    Lost motion counts by the direction that each axis came from.
    """
    moved = result.model.displacement_mm(at, result.theta)
    moved = moved + find_lost_motion_mm(result, at)
    moved = moved + compute_second_order_mm(result.model, at, result.theta)
    return moved if correction is None else moved + correction(at)


def find_poses(
    result: CalibrationResult,
    parts: Sequence[Observations],
    correction: Correction | None,
) -> Sequence[RunInput]:
    """Return the pose and the noise of each part, whatever its machine is.

    The noise is that beside a machine which is free to err otherwise than the result
    says, so that what the result gets wrong does not pass for noise. Of what the result
    explains nothing is left to be taken for errors: noise is not lost to them either.
    """
    known = extract_known_effects(
        result.model, np.zeros(result.model.size), result.covariance
    ).loosen()
    models = build_run_models(
        result.machine, [part.at for part in parts], known.effects
    )
    starts = [_take_off(result, part, correction) for part in parts]
    try:
        return _settle_noise(models.coarse, starts, known)
    except Unidentifiable:  # too few places to tell: as loud as is usual
        return [replace(one, noise=raise_noise(one.noise)) for one in starts]


def _take_off(
    result: CalibrationResult, part: Observations, correction: Correction | None
) -> RunInput:
    """Return what a result leaves unexplained of a part, with its rough pose."""
    moved = predict_displacement(result, part.at, correction)
    rest = replace(part, tracker_mm=part.tracker_mm - moved @ part.pose.rotation.T)
    return RunInput(rest, part.pose, guess_noise(part, perpendicular_only=False))


def _settle_noise(
    model: MachineModel, starts: Sequence[RunInput], known: KnownEffects
) -> Sequence[RunInput]:
    """Return pose and noise with how far the machine errs judged by that same noise.

    By a noise that is too low, some of it passes for error of the free machine, which
    the next noise then lacks: few places cannot tell, so both are found in turn.
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
