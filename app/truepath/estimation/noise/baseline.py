"""The baseline: the model that Runs are compared with, and the noise of each Run.

Either the rigid-body model is fitted to the Runs, with error motions as smooth as the
data require, or a reference model is given. The noise is estimated together with
splines of time: slow change is structure to be explained and must not count as noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float64
from scipy.linalg import block_diag

from truepath.alignment.observations.observations import Observations
from truepath.errors import Unidentifiable
from truepath.estimation.noise.noise_fit import guess_noise, refine_runs
from truepath.estimation.problem.confounded_prior import FullPrior, guess_full_prior
from truepath.estimation.problem.design_matrix import Linearisation, middle_of
from truepath.estimation.problem.information import (
    Information,
    Posterior,
    compute_posterior,
    invert_covariance,
)
from truepath.estimation.problem.knots import (
    can_refine,
    compute_intervals,
    refine_motions,
)
from truepath.estimation.problem.noise import NoiseModel, limit_place_noise
from truepath.estimation.problem.normal_equations import (
    RunInput,
    collect_information,
    combine_runs,
)
from truepath.kinematics.coarse_model import LONGEST_NOISE_S, NestedModels, add_effects
from truepath.kinematics.effects.base import Effect
from truepath.kinematics.effects.instrument import is_tracker_error
from truepath.kinematics.effects.pose_timing_seats import TrackerPose
from truepath.kinematics.model import EstimatedModel, MachineModel
from truepath.numerics.rigid import RigidTransform


@dataclass(frozen=True)
class KnownMachine:
    """A reference model with its covariance, used as the prior."""

    model: MachineModel
    covariance: Float64[np.ndarray, "m m"]

    @cached_property
    def precision(self) -> Float64[np.ndarray, "m m"]:
        """Inverse covariance; a parameter without variance is known to rounding."""
        return invert_covariance(self.covariance)

    def precision_matrix(self, size: int) -> Float64[np.ndarray, "p p"]:
        return np.pad(self.precision, (0, size - len(self.covariance)))

    def widen_tracker(self, times: float) -> KnownMachine:
        scale = np.ones(len(self.covariance))
        for effect in filter(is_tracker_error, self.model.effects):
            scale[self.model.slices[effect.name]] = times
        return replace(self, covariance=scale[:, None] * self.covariance * scale)

    def fit(self, data: Information) -> tuple[KnownMachine, Posterior]:
        return self, compute_posterior(data, self.precision_matrix(len(data.vector)))

    def measure_departure(self, theta: Float64[np.ndarray, " p"]) -> float:
        own = theta[: len(self.covariance)]
        return float(own @ self.precision @ own)


MachinePrior = FullPrior | KnownMachine
"""Knowledge of the machine before the Runs."""


@dataclass(frozen=True)
class Baseline:
    """The model that Runs are compared with.

    theta : (p,) about which the model is linear: 0 where it is fitted to the Runs
    prior : of the machine's parameters
    runs : coarse observations, pose and noise of each Run
    noise_model : used to estimate the noise
    """

    model: MachineModel
    theta: Float64[np.ndarray, " p"]
    prior: MachinePrior
    runs: tuple[RunInput, ...]
    noise_model: MachineModel

    def limit_place_noise(self) -> Baseline:
        """With noise between places limited to what is typical."""
        calm = [limit_place_noise(run.noise) for run in self.runs]
        if calm == [run.noise for run in self.runs]:
            return self
        each = zip(self.runs, calm, strict=True)
        return replace(self, runs=tuple(replace(r, noise=n) for r, n in each))

    def linearise(self, run: int) -> Linearisation:
        """The problem of a Run, linear about pose and `theta`."""
        own = self.runs[run]
        return Linearisation(
            self.model,
            TrackerPose(middle_of(own.observations)),
            own.pose,
            own.noise,
            self.theta,
            len(self.runs),
        )


def fit_baseline(
    nested: NestedModels,
    noise_model: MachineModel,
    observations: Sequence[Observations],
    reference: EstimatedModel | None = None,
) -> Baseline:
    """Prior, poses and noise of Runs of one machine.

    observations : of each Run, in coarse cells with their surroundings
    reference : fixed model; None fits the model to the Runs. Instrument errors follow
        it in the model, with unit variance each

    Raises Unidentifiable if the lines do not determine the noise.
    """
    guessed = [RunInput(o, o.pose, _guess_noise(o)) for o in observations]
    runs = _fit_noise(noise_model, guessed)
    if reference is None:
        nested = replace(nested, alone=_refine_knots(nested.alone, runs))
        prior: MachinePrior = FullPrior.guess(nested.alone, nested.confounded)
        theta = np.zeros(nested.with_confounded.size)
    else:
        more = nested.alone.size - len(reference.theta)
        theta = np.pad(reference.theta, (0, more))
        prior = KnownMachine(
            nested.alone, block_diag(reference.covariance, np.eye(more))
        )
    return Baseline(nested.with_confounded, theta, prior, runs, noise_model)


def _refine_knots(model: MachineModel, runs: Sequence[RunInput]) -> MachineModel:
    while any(map(can_refine, model.error_motions)):
        data = combine_runs(collect_information(runs, model))
        prior, result = guess_full_prior(model).fit(data)
        intervals = compute_intervals(model, prior.precision, result)
        if not intervals:
            break
        model = refine_motions(model, intervals)
    return model


def refit_noise(baseline: Baseline, effects: Sequence[Effect]) -> Baseline:
    """Pose and noise of the Runs fitted together with effects.

    Unchanged where the effects leave too little data to determine the noise.
    """
    model = add_effects(baseline.noise_model, effects)
    guessed = [replace(r, noise=_guess_noise(r.observations)) for r in baseline.runs]
    try:
        return replace(baseline, runs=_fit_noise(model, guessed))
    except Unidentifiable:
        return baseline


def _guess_noise(observations: Observations) -> NoiseModel:
    return guess_noise(observations, perpendicular_only=False)


def _fit_noise(model: MachineModel, runs: Sequence[RunInput]) -> tuple[RunInput, ...]:
    return tuple(
        replace(run, observations=replace_pose(run.observations, run.pose))
        for run in refine_runs(model, runs, longest_s=LONGEST_NOISE_S)
    )


def replace_pose(observations: Observations, pose: RigidTransform) -> Observations:
    """Also replaces the rotation in the recorded surroundings."""
    recorded = observations.at.recorded
    if recorded is not None:
        recorded = replace(recorded, rotation=pose.rotation)
    at = replace(observations.at, recorded=recorded)
    return replace(observations, pose=pose, at=at)
