"""Several Runs in one estimate: the information of each on the machine, and the sum.

The machine is common to all; the tracker's position, the timing on each line and the
noise of the air belong to one Run. So pose and timing are integrated out of the
information of each Run, which loses nothing (they have no prior), and the rest, on the
machine's parameters, adds. Time and memory grow with the number of Runs, the solve does
not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from truepath.alignment.observations.observations import Observations
from truepath.errors import Unidentifiable
from truepath.estimation.problem.design_matrix import Linearisation, linearise
from truepath.estimation.problem.information import (
    Information,
    OwnParameters,
    add_information,
)
from truepath.estimation.problem.noise import NoiseModel
from truepath.estimation.problem.normal_equations import compute_information
from truepath.kinematics.effects.base import Effect
from truepath.kinematics.model import MachineModel
from truepath.numerics.rigid import RigidTransform


@dataclass(frozen=True, slots=True)
class RunInput:
    """Inputs of the solve from one Run.

    pose : workpiece to tracker, about which the problem is linear
    """

    observations: Observations
    pose: RigidTransform
    noise: NoiseModel


@dataclass(frozen=True, slots=True)
class RunInformation:
    """Information of one Run, on its pose as well.

    data : over all parameters of the linearisation
    weak : precision of its pose that is in the data in addition to the cells
    """

    observations: Observations
    linearisation: Linearisation
    data: Information
    weak: Float64[np.ndarray, "6"] | None = None

    @property
    def noise(self) -> NoiseModel:
        return self.linearisation.noise

    @property
    def own(self) -> OwnParameters:
        """Its pose, to be eliminated or restored. Raises Unidentifiable."""
        return OwnParameters.of(self.data, self.linearisation.machine_model.size)

    def replace_noise(self, noise: NoiseModel) -> RunInformation:
        """Recomputed from the observations, which takes as long as the first time."""
        linearisation = replace(self.linearisation, noise=noise)
        data = compute_information(self.observations, linearisation)
        return RunInformation(self.observations, linearisation, data)

    def restrict(self, effects: Sequence[Effect]) -> RunInformation:
        keep = self.linearisation.select_columns(effects)
        return RunInformation(
            self.observations,
            self.linearisation.restrict(effects),
            self.data.select(keep),
        )


def collect_information(
    runs: Sequence[RunInput], model: MachineModel
) -> tuple[RunInformation, ...]:
    """Linearised about the pose of each Run; one item for each."""
    found: list[RunInformation] = []
    for run in runs:
        about = linearise(run.observations, model, run.pose, run.noise)
        data = compute_information(run.observations, about)
        found.append(RunInformation(run.observations, about, data))
    return tuple(found)


def combine_runs(runs: Sequence[RunInformation]) -> Information:
    """Information of all Runs on the machine, poses integrated out.

    Raises Unidentifiable, with the number of the Run where there are several.
    """
    parts: list[Information] = []
    for number, run in enumerate(runs, start=1):
        try:
            parts.append(run.own.eliminate())
        except Unidentifiable as error:
            if len(runs) == 1:
                raise
            raise Unidentifiable(f"Run {number} of {len(runs)}: {error}") from error
    return add_information(parts)
