"""What moves the target in the eyes of the tracker, and nothing else.

It is known only where the tracker stands: without a recording there is none of it.
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
    """The target seems to move along one arm, in the frame of the tracker."""

    role = Role.MEASUREMENT

    @abstractmethod
    def arm(self, recorded: RecordedState) -> Float64[np.ndarray, "n 3"]:
        """Return how the target seems to move, in the tracker's frame."""

    def sizes(
        self, at: Conditions, recorded: RecordedState
    ) -> Float64[np.ndarray, "n p"]:
        """Return how far along the arm, for each parameter; 1 where left out."""
        del recorded
        return np.ones((len(at), 1))

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 p"]:
        """Return the arm in the frame the tracker stands on, times the sizes."""
        recorded = at.recorded
        if recorded is None:
            return np.zeros((len(at), 3, len(self.units)))
        arm = self.arm(recorded) @ recorded.rotation
        return columns_along(arm, self.sizes(at, recorded))


class BeamFamily(Family):
    """Candidates where it is known how the tracker looks at the target."""

    role = Role.MEASUREMENT

    @abstractmethod
    def propose_for(
        self, at: Conditions, recorded: RecordedState
    ) -> Sequence[Candidate]:
        """Return what may be looked for."""

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        """Return what may be looked for; nothing without a recording."""
        return [] if at.recorded is None else self.propose_for(at, at.recorded)


def raise_beam(recorded: RecordedState) -> Float64[np.ndarray, "n 3"]:
    """Return how a target moves with its elevation, mm per rad."""
    x, y, z = recorded.tracker_mm.T
    azimuth = np.arctan2(y, x)
    across = [-z * np.cos(azimuth), -z * np.sin(azimuth), np.hypot(x, y)]
    return np.stack(across, axis=1)
