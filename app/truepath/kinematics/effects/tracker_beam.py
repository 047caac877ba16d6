"""Apparent motions of the target that only the tracker sees.

They need the tracker's pose, so they are 0 without a recording.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64

from truepath.kinematics.conditions import Conditions, RecordedState
from truepath.kinematics.effects.base import Effect, Role, columns_along
from truepath.kinematics.effects.family import Candidate, Family


class BeamEffect(Effect):
    """Apparent motion of the target along one arm, in the tracker's frame."""

    role = Role.MEASUREMENT

    @abstractmethod
    def arm(self, recorded: RecordedState) -> Float64[np.ndarray, "n 3"]:
        """Apparent motion of the target per unit, in the tracker's frame."""

    def sizes(
        self, at: Conditions, recorded: RecordedState
    ) -> Float64[np.ndarray, "n p"]:
        """Size along the arm for each parameter; 1 by default."""
        del recorded
        return np.ones((len(at), 1))

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 p"]:
        """Arm in the frame on which the tracker stands, times the sizes."""
        recorded = at.recorded
        if recorded is None:
            return np.zeros((len(at), 3, len(self.units)))
        arm = self.arm(recorded) @ recorded.rotation
        return columns_along(arm, self.sizes(at, recorded))


class BeamFamily(Family):
    """Candidates that need the beam direction of a recording."""

    @abstractmethod
    def propose_for(
        self, at: Conditions, recorded: RecordedState
    ) -> Sequence[Candidate]:
        """As `propose`, with a recording at hand."""

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        """No candidates without a recording."""
        return [] if at.recorded is None else self.propose_for(at, at.recorded)


def raise_beam(recorded: RecordedState) -> Float64[np.ndarray, "n 3"]:
    """Motion of a target with its elevation, mm per rad."""
    x, y, z = recorded.tracker_mm.T
    azimuth = np.arctan2(y, x)
    across = [-z * np.cos(azimuth), -z * np.sin(azimuth), np.hypot(x, y)]
    return np.stack(across, axis=1)
