"""The best that any estimator could do with a recording, on average.

The ideal estimator is ours told three things that no real one knows: the noise (level,
correlated share, correlation time: the simulator's own figures, and that the feed is
exact), that carriages do not lean under acceleration, and how strongly each error
motion bends (prior precisions fitted to the true error motions, (K − 2) / ∫ bending).
What the tracker may be off by has the prior of its specification, as in every estimate.
Its posterior covariance is the bound: the root mean square, over the volume, of the
error that it would leave on average. It can be beaten on one machine by luck, not on
average by a machine of these errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from judging import Volume, map_mm, true_parameters

from truepath.alignment.observations.observations import Observations
from truepath.estimation.problem.design_matrix import linearise
from truepath.estimation.problem.information import (
    OwnParameters,
    add_information,
    compute_posterior,
)
from truepath.estimation.problem.noise import NoiseModel
from truepath.estimation.problem.normal_equations import compute_information
from truepath.estimation.solve.batch import Estimate
from truepath.kinematics.coarse_model import InertialBend
from truepath.kinematics.effects.error_motion import ErrorMotion
from truepath.kinematics.effects.instrument import is_tracker_error
from truepath.kinematics.model import MachineModel
from truepath_simulators.machine.tracker_head import Air
from truepath_simulators.worlds.recording import Recording


@dataclass(frozen=True)
class Ideal:
    """What the ideal estimator states and what it leaves on this recording.

    bound_mm : root mean square length of the error left, as its covariance states
    error_mm : (n, 3) its map; theta : its parameters
    """

    bound_mm: float
    error_mm: np.ndarray
    sigma_mm: np.ndarray
    theta: np.ndarray


def ideal(
    within: Volume,
    seen: Sequence[Observations],
    found: Estimate,
    recording: Recording,
    air: Air,
) -> Ideal:
    """Return the ideal estimate from the observations of an estimate, of each Run.

    What the target does not tell merges with what it does.
    """
    whole = found.model
    leaning = {e.name for e in whole.effects if isinstance(e, InertialBend)}
    left_out = whole.confounded | leaning
    told = [e for e in whole.effects if e.name not in left_out]
    model = MachineModel(whole.machine, tuple(told))
    told_by = []
    for one, run in zip(seen, found.runs, strict=True):
        about = linearise(one, model, run.pose, true_noise(air))
        data = compute_information(one, about)
        told_by.append(OwnParameters.of(data, model.size).eliminate())
    precision = true_precision(model, true_parameters(model, recording.truth))
    best = compute_posterior(add_information(told_by), precision)
    error, sigma = map_mm(within, model, best.theta, best.covariance)
    return Ideal(within.rms_length(sigma), error, sigma, best.theta)


def true_noise(air: Air) -> NoiseModel:
    """Return the noise that the simulator draws; its feed has no jitter."""
    white = float(np.sqrt(1.0 - air.share**2))
    return NoiseModel((white, white), (air.share, air.share, air.share), air.tau_s, 0.0)


def true_precision(model: MachineModel, truth: np.ndarray) -> np.ndarray:
    """Return the prior precision whose precisions fit the true error motions."""
    total = np.zeros((model.size, model.size))
    for effect in model.effects:
        part = model.slices[effect.name]
        if is_tracker_error(effect):
            total[part, part] = np.eye(part.stop - part.start)
        if isinstance(effect, ErrorMotion):
            bending = effect.gauge.T @ effect.spline.bending() @ effect.gauge
            energy = float(truth[part] @ bending @ truth[part])
            total[part, part] = (effect.spline.size - 2) / energy * bending
    return total
