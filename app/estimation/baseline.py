"""The baseline: the model that Runs are compared with, and the noise of each Run.

Either the rigid-body model is fitted to the Runs, its error motions as smooth as the
data say, or a reference model is given. The noise is estimated beside splines of time:
what changes slowly is structure to be explained and must not be counted as noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from jaxtyping import Float64

from app.alignment.observations import Observations
from app.alignment.surroundings import with_pose
from app.errors import Unidentifiable
from app.estimation.information import Information, Posterior, compute_posterior
from app.estimation.noise import NoiseModel
from app.estimation.noise_fit import guess_noise, refine_runs
from app.estimation.prior import BendingPrior, fit_prior, guess_prior
from app.estimation.runs import RunInput
from app.kinematics.effects.base import Effect
from app.kinematics.effects.of_run import EffectOfRun
from app.kinematics.effects.time_spline import time_splines
from app.kinematics.identifiable import identifiable_model
from app.kinematics.machine import Machine
from app.kinematics.model import MachineModel

_LONGEST_NOISE_S = 6.0  # of the noise's correlation time
_POINTS_PER_KNOT = 6  # of a spline of time, where the machine stands at points


class MachinePrior(Protocol):
    """What is known of the machine before the Runs."""

    def precision_matrix(self, size: int) -> Float64[np.ndarray, "p p"]:
        """Return the prior precision; parameters after the machine's have none."""
        ...

    def fit(self, data: Information) -> tuple[MachinePrior, Posterior]:
        """Return the prior that fits the data, and the posterior under it."""
        ...


@dataclass(frozen=True)
class SmoothMotions:
    """Error motions of any shape, as smooth as the data say."""

    bending: BendingPrior

    def precision_matrix(self, size: int) -> Float64[np.ndarray, "p p"]:
        """Return the precision of the bending energies."""
        return self.bending.precision_matrix(size)

    def fit(self, data: Information) -> tuple[SmoothMotions, Posterior]:
        """Return the prior whose precisions fit the data, and the posterior."""
        bending, result = fit_prior(data, self.bending)
        return SmoothMotions(bending), result


@dataclass(frozen=True)
class KnownMachine:
    """Parameters of a reference model, as well as it knows them."""

    known: Float64[np.ndarray, "m m"]

    def precision_matrix(self, size: int) -> Float64[np.ndarray, "p p"]:
        """Return the inverse of the reference model's covariance."""
        total = np.zeros((size, size))
        total[: len(self.known), : len(self.known)] = self.known
        return total

    def fit(self, data: Information) -> tuple[KnownMachine, Posterior]:
        """Return itself, which has nothing to fit, and the posterior."""
        return self, compute_posterior(data, self.precision_matrix(len(data.vector)))


@dataclass(frozen=True)
class ReferenceModel:
    """A model from a file: effects, their parameters and covariance."""

    model: MachineModel
    theta: Float64[np.ndarray, " p"]
    covariance: Float64[np.ndarray, "p p"]

    def prior(self) -> KnownMachine:
        """Return the precision; a parameter without variance is known to rounding."""
        value, vector = np.linalg.eigh(self.covariance)
        floor = 1e-9 * float(value.max(initial=1e-18))
        return KnownMachine((vector / np.maximum(value, floor)) @ vector.T)


@dataclass(frozen=True)
class Baseline:
    """The model that Runs are compared with.

    theta : (p,) about which the model is linear: 0 where it is fitted to the Runs
    prior : of the machine's parameters
    runs : coarse observations, pose and noise of each Run
    """

    model: MachineModel
    theta: Float64[np.ndarray, " p"]
    prior: MachinePrior
    runs: tuple[RunInput, ...]


def fit_baseline(
    machine: Machine,
    observations: Sequence[Observations],
    reference: ReferenceModel | None = None,
) -> Baseline:
    """Return model, prior, poses and noise of Runs of one machine.

    observations : of each Run, in coarse cells with their surroundings
    reference : the model; the rigid-body model fitted to the Runs if None

    Raises Unidentifiable if the lines do not determine the noise.
    """
    if reference is None:
        model, _ = identifiable_model(machine, *(o.at.offset_mm for o in observations))
        theta, prior = np.zeros(model.size), SmoothMotions(guess_prior(model))
    else:
        model, theta, prior = reference.model, reference.theta, reference.prior()
    runs = tuple(RunInput(o, o.pose, _first_noise(o)) for o in observations)
    return Baseline(model, theta, prior, _fit_noise(model, runs, ()))


def refit_noise(baseline: Baseline, effects: Sequence[Effect]) -> Baseline:
    """Return the baseline with pose and noise of the Runs fitted beside effects.

    Where the effects leave nothing to judge the noise by, it stays as it is.
    """
    runs = tuple(replace(r, noise=_first_noise(r.observations)) for r in baseline.runs)
    try:
        return replace(baseline, runs=_fit_noise(baseline.model, runs, effects))
    except Unidentifiable:
        return baseline


def _first_noise(observations: Observations) -> NoiseModel:
    return guess_noise(observations, perpendicular_only=False)


def _fit_noise(
    model: MachineModel, runs: Sequence[RunInput], effects: Sequence[Effect]
) -> tuple[RunInput, ...]:
    """Return the Runs with pose and noise beside effects and what changes slowly."""
    slow = [
        EffectOfRun(spline, number)
        for number, run in enumerate(runs)
        for spline in time_splines(
            run.observations.at, _knot_spacing_s(run.observations)
        )
    ]
    beside = (*slow, *model.catalogued, *effects)
    better = refine_runs(model.machine, runs, beside, longest_s=_LONGEST_NOISE_S)
    return tuple(
        replace(run, observations=with_pose(run.observations, run.pose))
        for run in better
    )


def _knot_spacing_s(observations: Observations) -> float:
    """Return a distance of knots in time that follows no single point."""
    if observations.passes:
        return _LONGEST_NOISE_S
    each_s = float(np.ptp(observations.at.time_s)) / len(observations)
    return max(_LONGEST_NOISE_S, _POINTS_PER_KNOT * each_s)
