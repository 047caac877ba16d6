"""Where the tracker stands: the rigid motion of everything it sees."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.kinematics.conditions import Conditions
from app.kinematics.effects.base import Effect, Parameter, Role
from app.numerics.rigid import RigidTransform, cross_matrix


@dataclass(frozen=True)
class TrackerPose(Effect):
    """A small shift, and a small turn about a centre, of all measured points."""

    kind = "tracker-pose"
    role = Role.NUISANCE
    centre_mm: tuple[float, float, float]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Three shifts, three turns."""
        shifts = [Parameter(f"pose-shift-{d}", "mm") for d in "xyz"]
        turns = [Parameter(f"pose-turn-{d}", "rad") for d in "xyz"]
        return tuple(shifts + turns)

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 p"]:
        """Return shift + turn × (point − centre)."""
        columns = np.zeros((len(at), 3, 6))
        columns[:, :, :3] = np.eye(3)
        columns[:, :, 3:] = cross_matrix(at.point_mm - np.array(self.centre_mm))
        return columns

    def correct(
        self, pose: RigidTransform, theta: Float64[np.ndarray, " p"]
    ) -> RigidTransform:
        """Return a pose with these parameters in it."""
        translation, rotation = theta[:3], theta[3:]
        centre = np.array(self.centre_mm)
        return pose.precede_small(rotation, translation - np.cross(rotation, centre))
