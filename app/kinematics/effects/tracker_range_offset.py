"""A wrong home distance of the tracker, or a wrong offset of the reflector."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.kinematics.conditions import Conditions
from app.kinematics.effects.base import Effect, Parameter, Role
from app.kinematics.effects.catalogue import (
    USUAL_MM,
    Candidate,
    Family,
    Measured,
    Signature,
)


@dataclass(frozen=True)
class TrackerRangeOffset(Effect):
    """Every distance is too long by the same amount."""

    @property
    def name(self) -> str:
        """Name in the provenance of an estimate."""
        return "tracker-range-offset"

    @property
    def role(self) -> Role:
        """What it belongs to."""
        return Role.MEASUREMENT

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The offset, in mm."""
        return (Parameter(self.name, "mm"),)

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 1"]:
        """Return the unit beam in the frame the tracker stands on."""
        if at.recorded is None:
            return np.zeros((len(at), 3, 1))
        distance = np.linalg.norm(at.recorded.tracker_mm, axis=1, keepdims=True)
        beam = at.recorded.tracker_mm / distance
        return (beam @ at.recorded.rotation)[:, :, None]


class TrackerRangeOffsetFamily(Family):
    """One candidate."""

    name = "tracker-range-offset"
    in_machine = False
    signature = Signature(
        cause="The tracker's home distance, or the constant of the reflector in use, "
        "is wrong.",
        looks_like="All points lie too far from the tracker by the same amount: the "
        "volume looks bent about it.",
        remedy="Set the home distance again with the reflector in its nest; choose the "
        "right reflector in the tracker's software.",
    )

    def candidates(self, at: Conditions) -> Sequence[Candidate]:
        """Return the offset."""
        if at.recorded is None:
            return []
        usual = np.array([4.0 * USUAL_MM])
        return [Candidate(self.name, {}, TrackerRangeOffset(), usual)]

    def parameters(
        self,
        candidate: Candidate,
        theta: Float64[np.ndarray, "1"],
        covariance: Float64[np.ndarray, "1 1"],
        value_sigma: float,
    ) -> dict[str, Measured]:
        """Return the offset."""
        return {"offset_um": Measured.only(theta, covariance, 1e3)}
