"""Several Runs in one estimate: what each tells of the machine, and all together.

The machine is the same in all; where the tracker stands, when the machine was where on
a line and how loud the air is belong to one Run. So pose and timing are integrated out
of the information of each Run, which loses nothing (they have no prior), and what is
left on the machine's parameters adds. Time and memory grow with the number of Runs, the
solve does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from app.alignment.observations import Observations
from app.errors import Unidentifiable
from app.estimation.information import (
    Information,
    Posterior,
    added,
    information,
    rest_per_first,
    with_rest,
    without_rest,
)
from app.estimation.noise import NoiseModel
from app.estimation.problem import (
    Problem,
    columns_with,
    pose_problem,
    with_machine_effects,
)
from app.kinematics.effects.base import Effect
from app.kinematics.model import MachineModel
from app.numerics.rigid import RigidTransform


@dataclass(frozen=True, slots=True)
class Measured:
    """One Run as the solve takes it.

    pose : workpiece to tracker, about which the problem is linear
    """

    seen: Observations
    pose: RigidTransform
    noise: NoiseModel


@dataclass(frozen=True, slots=True)
class Share:
    """What one Run tells, of its own pose and timing as well.

    data : over all parameters of `problem.model`
    """

    problem: Problem
    noise: NoiseModel
    data: Information

    @property
    def about_machine(self) -> Information:
        """What it tells of the machine. Raises Unidentifiable."""
        return without_rest(self.data, self.problem.machine_model.size)

    @property
    def own_per_machine(self) -> Float64[np.ndarray, "r p"]:
        """How far its own parameters go against those of the machine."""
        return rest_per_first(self.data, self.problem.machine_model.size)

    def completed(
        self, machine: Posterior
    ) -> tuple[Float64[np.ndarray, " p"], Float64[np.ndarray, "r r"]]:
        """Return all parameters of the problem, and the covariance of its own."""
        return with_rest(self.data, machine)


def share_of(run: Measured, model: MachineModel) -> Share:
    """Return what a Run tells of a model's parameters."""
    timing = bool(np.isfinite(run.noise.along_sigma_mm))
    problem = pose_problem(run.seen, model, run.pose, timing=timing)
    return with_noise(problem, run.noise)


def with_noise(problem: Problem, noise: NoiseModel) -> Share:
    """Return what a problem tells under a noise model."""
    return Share(problem, noise, information(problem, noise))


def shares_of(runs: Sequence[Measured], model: MachineModel) -> tuple[Share, ...]:
    """Return what each Run tells of a model's parameters."""
    return tuple(share_of(run, model) for run in runs)


def together(shares: Sequence[Share]) -> Information:
    """Return what all Runs tell of the machine.

    Raises Unidentifiable, with the number of the Run where there are several.
    """
    parts: list[Information] = []
    for number, share in enumerate(shares, start=1):
        try:
            parts.append(share.about_machine)
        except Unidentifiable as error:
            if len(shares) == 1:
                raise
            raise Unidentifiable(f"Run {number} of {len(shares)}: {error}") from error
    return added(parts)


def with_effects_only(share: Share, effects: Sequence[Effect]) -> Share:
    """Return what a Run tells where only some of the machine's effects are."""
    problem = share.problem
    keep = columns_with(problem, effects)
    data = replace(
        share.data,
        matrix=share.data.matrix[np.ix_(keep, keep)],
        vector=share.data.vector[keep],
    )
    return Share(with_machine_effects(problem, effects), share.noise, data)
