"""What Runs are held against: the rigid-body model fitted to them, or a given one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from jaxtyping import Float64

from app.alignment.align import align
from app.alignment.observations import Observations
from app.discovery.scene import at_pose, in_surroundings
from app.discovery.view import Base
from app.errors import Unidentifiable
from app.estimation.information import Information, Posterior, posterior
from app.estimation.noise_fit import first_noise, looked_at
from app.estimation.prior import BendingPrior, first_guess, fitted
from app.estimation.runs import Measured
from app.files.one_machine import one_machine
from app.files.run import Run
from app.kinematics.effects.base import Effect
from app.kinematics.effects.of_run import OfRun
from app.kinematics.effects.time_spline import time_splines
from app.kinematics.identifiable import identifiable_model
from app.kinematics.model import MachineModel

_POINTS = 6  # to a knot, where the machine stands
_SPLINE_S = 6.0  # what is slower is structure to be explained, not noise


class BasePrior(Protocol):
    """What is known of machine and pose before the Run."""

    def precision_matrix(self, size: int) -> Float64[np.ndarray, "p p"]:
        """Return the prior precision; what follows the machine has none."""
        ...

    def fitted(self, data: Information) -> tuple[BasePrior, Posterior]:
        """Return the prior that fits the data, and the posterior under it."""
        ...


@dataclass(frozen=True)
class Elastic:
    """Any smooth error motions, as smooth as the data say."""

    bending: BendingPrior

    def precision_matrix(self, size: int) -> Float64[np.ndarray, "p p"]:
        """Return the bending energies."""
        return self.bending.precision_matrix(size)

    def fitted(self, data: Information) -> tuple[Elastic, Posterior]:
        """Return the prior of precisions that fit the data."""
        bending, result = fitted(data, self.bending)
        return Elastic(bending), result


@dataclass(frozen=True)
class Known:
    """The error motions of a given model, as well as it knows them."""

    machine: Float64[np.ndarray, "m m"]

    def precision_matrix(self, size: int) -> Float64[np.ndarray, "p p"]:
        """Return the inverse of the model's covariance."""
        total = np.zeros((size, size))
        total[: len(self.machine), : len(self.machine)] = self.machine
        return total

    def fitted(self, data: Information) -> tuple[Known, Posterior]:
        """Return itself: there is nothing to choose."""
        return self, posterior(data, self.precision_matrix(len(data.vector)))


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
    """Base and prior of a Run, and the coarse cells that its noise is judged by."""

    base: Base
    prior: BasePrior
    coarse: Observations


def grounds_of(runs: Sequence[Run], given: GivenModel | None) -> tuple[Ground, ...]:
    """Return base, prior and noise of each Run; the machine is the same in all.

    given : the model they are held against; the rigid-body model fitted to them if None

    Raises BundleError if the Runs are not of one machine.
    """
    machine = one_machine([r.machine for r in runs], [r.name for r in runs])
    coarse = [
        in_surroundings(run, align(run), number) for number, run in enumerate(runs)
    ]
    if given is None:
        model, _ = identifiable_model(machine, *(seen.at.offset_mm for seen in coarse))
        given = GivenModel(model, np.zeros(model.size), np.zeros((0, 0)))
        prior: BasePrior = Elastic(first_guess(model))
    else:
        prior = given.known()
    return renoised(
        [Ground(_first_base(seen, given, len(runs)), prior, seen) for seen in coarse]
    )


def _first_base(seen: Observations, given: GivenModel, runs: int) -> Base:
    noise = first_noise(seen, perpendicular_only=False)
    x, y, z = seen.at.point_mm.mean(axis=0)
    centre = (float(x), float(y), float(z))
    return Base(given.model, seen.pose, centre, noise, given.theta, runs)


def _spacing_s(seen: Observations) -> float:
    """Return the distance of knots in time that points do not follow one by one."""
    if seen.passes:
        return _SPLINE_S
    each_s = float(np.ptp(seen.at.time_s)) / len(seen)
    return max(_SPLINE_S, _POINTS * each_s)


def renoised(
    grounds: Sequence[Ground], effects: Sequence[Effect] = ()
) -> tuple[Ground, ...]:
    """Return them with the pose and noise left beside effects and all that is slow.

    As they are where the effects leave nothing to judge the noise by.
    Raises Unidentifiable if without effects the lines do not tell it either.
    """
    model = grounds[0].base.model
    slow = [
        OfRun(spline, number)
        for number, ground in enumerate(grounds)
        for spline in time_splines(ground.coarse.at, _spacing_s(ground.coarse))
    ]
    runs = [
        Measured(g.coarse, g.base.pose, first_noise(g.coarse, perpendicular_only=False))
        for g in grounds
    ]
    try:
        beside = (*slow, *model.catalogued, *effects)
        better = looked_at(model.machine, runs, beside, longest_s=_SPLINE_S)
    except Unidentifiable:
        if not effects:
            raise
        return tuple(grounds)  # what is beside takes all that would tell
    return tuple(
        replace(
            ground,
            base=replace(ground.base, pose=found.pose, noise=found.noise),
            coarse=at_pose(ground.coarse, found.pose),
        )
        for ground, found in zip(grounds, better, strict=True)
    )
