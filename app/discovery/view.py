"""What one Run shows, what it is held against, and the columns of one line of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Float64
from numpy.typing import NDArray

from app.alignment.observations import Observations
from app.alignment.reduction import beam_frame
from app.estimation.noise import NoiseModel
from app.kinematics.effects.base import Effect
from app.kinematics.effects.catalogue import Wave
from app.kinematics.effects.of_run import EffectOfRun
from app.kinematics.effects.timing_law import TimingLaw
from app.kinematics.effects.tracker_pose import TrackerPose
from app.kinematics.model import MachineModel
from app.numerics.rigid import RigidTransform

TIMING = 2


@dataclass(frozen=True)
class Base:
    """What all explanations of a Run share: machine, pose, noise; linear about them.

    theta : (p,) of the model, about which the machine is linear: 0 where it is fitted
    runs : how many Runs are explained together, each with a pose of its own
    """

    model: MachineModel
    pose: RigidTransform
    centre_mm: tuple[float, float, float]
    noise: NoiseModel
    theta: Float64[np.ndarray, " p"]
    runs: int = 1

    @property
    def size(self) -> int:
        """Number of parameters of machine and poses."""
        return self.model.size + 6 * self.runs

    @property
    def poses(self) -> tuple[Effect, ...]:
        """Where the tracker stands, in each Run."""
        return tuple(
            EffectOfRun(TrackerPose(self.centre_mm), k) for k in range(self.runs)
        )


class FastSums(Protocol):
    """What samples tell within their cells."""

    def shows(self, effect: Effect) -> bool:
        """Tell whether an effect is fast, and of this Run."""
        ...

    def sums(
        self, effects: Sequence[Effect], folds: int
    ) -> tuple[Float64[np.ndarray, "k q q"], list[tuple[int, int]]]:
        """Return the sums on fast effects and data, and which columns they are."""
        ...

    def squares(self, folds: int) -> Float64[np.ndarray, " k"]:
        """Return the weighted squares of the data."""
        ...

    def wave(
        self, wave: Wave
    ) -> tuple[NDArray[np.complex128], Float64[np.ndarray, " v"]]:
        """Return data and weight of a wave in time."""
        ...

    def freedom(self, folds: int) -> Float64[np.ndarray, " k"]:
        """Return their degrees of freedom."""
        ...


@dataclass(frozen=True)
class View:
    """What one Run shows, and what it is held against.

    within : what its samples tell within their cells
    """

    seen: Observations
    base: Base
    within: FastSums | None = None


def stretches(seen: Observations) -> list[tuple[int, int]]:
    """Return first cell and one past the last of each line or standstill."""
    breaks = (np.diff(seen.at.line) != 0) | (np.diff(seen.row) != 0)
    begin = np.flatnonzero(np.concatenate([[True], breaks]))
    return [
        (int(a), int(b))
        for a, b in zip(begin, np.append(begin[1:], len(seen)), strict=True)
    ]


def line_rows(
    seen: Observations, base: Base, effects: Sequence[Effect]
) -> tuple[Float64[np.ndarray, "n 3 q"], Float64[np.ndarray, "n 3 3"]]:
    """Return rows over timing, machine, poses, effects and data; and the beam frame."""
    more = [e.jacobian(seen.at) for e in (*base.poses, *effects)]
    columns = np.concatenate([base.model.jacobian(seen.at), *more], axis=2)
    local = np.zeros((len(seen), 3, TIMING + columns.shape[2] + 1))
    line = int(seen.at.line[0])
    if line >= 0:
        local[:, :, :TIMING] = TimingLaw((line,)).jacobian(seen.at)
    local[:, :, TIMING:-1] = columns
    local[:, :, -1] = base.pose.invert().apply(seen.tracker_mm) - seen.at.point_mm
    machine = slice(TIMING, TIMING + base.model.size)
    local[:, :, -1] -= local[:, :, machine] @ base.theta
    frame = beam_frame(seen.tracker_mm) @ base.pose.rotation
    return np.matmul(frame, local), frame
