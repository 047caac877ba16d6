"""What a Run is held against: the rigid-body model fitted to it, or a given model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from jaxtyping import Float64

from app.alignment.align import align
from app.alignment.observations import Observations
from app.discovery.scene import at_pose, with_surroundings
from app.discovery.sums import Base
from app.estimation.identifiable import identifiable_model
from app.estimation.information import Information, Posterior, posterior
from app.estimation.noise_fit import first_noise, looked_at
from app.estimation.prior import BendingPrior, first_guess, fitted
from app.estimation.runs import Measured
from app.kinematics.effects.base import Effect
from app.kinematics.effects.catalogued import Catalogued
from app.kinematics.effects.time_spline import time_splines
from app.kinematics.model import MachineModel
from app.measurement.run import Run

_SPLINE_S = 6.0  # what is slower is structure to be explained, not noise


class BasePrior(Protocol):
    """What is known of machine and pose before the Run."""

    def precision(self, size: int) -> Float64[np.ndarray, "p p"]:
        """Return the prior precision; what follows the machine has none."""
        ...

    def fitted(self, data: Information) -> tuple[BasePrior, Posterior]:
        """Return the prior that fits the data, and the posterior under it."""
        ...


@dataclass(frozen=True)
class Elastic:
    """Any smooth error motions, as smooth as the data say."""

    bending: BendingPrior

    def precision(self, size: int) -> Float64[np.ndarray, "p p"]:
        """Return the bending energies."""
        return self.bending.precision(size)

    def fitted(self, data: Information) -> tuple[Elastic, Posterior]:
        """Return the prior of strengths that fit the data."""
        bending, result = fitted(data, self.bending)
        return Elastic(bending), result


@dataclass(frozen=True)
class Known:
    """The error motions of a given model, as well as it knows them."""

    machine: Float64[np.ndarray, "m m"]

    def precision(self, size: int) -> Float64[np.ndarray, "p p"]:
        """Return the inverse of the model's covariance."""
        total = np.zeros((size, size))
        total[: len(self.machine), : len(self.machine)] = self.machine
        return total

    def fitted(self, data: Information) -> tuple[Known, Posterior]:
        """Return itself: there is nothing to choose."""
        return self, posterior(data, self.precision(len(data.vector)))


@dataclass(frozen=True)
class GivenModel:
    """A model from a file: effects, their parameters and covariance."""

    model: MachineModel
    theta: Float64[np.ndarray, " p"]
    covariance: Float64[np.ndarray, "p p"]

    def known(self) -> Known:
        """Return what it knows; what it does not vary at all, it knows to rounding."""
        value, vector = np.linalg.eigh(self.covariance)
        floor = 1e-9 * float(value.max(initial=1e-18))
        return Known((vector / np.maximum(value, floor)) @ vector.T)


@dataclass(frozen=True)
class Ground:
    """Base and prior, and the coarse cells that the noise is judged by."""

    base: Base
    prior: BasePrior
    coarse: Observations


def ground_of(run: Run, given: GivenModel | None) -> Ground:
    """Return base, prior and noise of a Run.

    given : the model it is held against; the rigid-body model fitted to it if None
    """
    coarse = with_surroundings(run, align(run))
    noise = first_noise(coarse, perpendicular_only=False)
    x, y, z = coarse.at.point_mm.mean(axis=0)
    if given is None:
        model, _ = identifiable_model(run.machine, coarse.at.offset_mm)
        given = GivenModel(model, np.zeros(model.size), np.zeros((0, 0)))
        prior: BasePrior = Elastic(first_guess(model))
    else:
        prior = given.known()
    centre = (float(x), float(y), float(z))
    base = Base(given.model, coarse.pose, centre, noise, given.theta)
    return renoised(Ground(base, prior, coarse))


def renoised(ground: Ground, effects: Sequence[Effect] = ()) -> Ground:
    """Return it with the pose and noise that are left beside effects and all slow."""
    coarse, base = ground.coarse, ground.base
    known = [e for e in base.model.effects if isinstance(e, Catalogued)]
    beside = (*time_splines(coarse.at, _SPLINE_S), *known, *effects)
    noise = first_noise(coarse, perpendicular_only=False)
    runs = [Measured(coarse, base.pose, noise)]
    (found,) = looked_at(coarse.at.machine, runs, beside)
    return replace(
        ground,
        base=replace(base, pose=found.pose, noise=found.noise),
        coarse=at_pose(coarse, found.pose),
    )
