"""Tracker or table that creeps steadily during the measurement."""

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

_AXES = ("x", "y", "z")


@dataclass(frozen=True)
class TableDrift(Effect):
    """A shift of all points that grows with time, from the middle of the run."""

    middle_s: float

    @property
    def name(self) -> str:
        """Name in the provenance of an estimate."""
        return "table-drift"

    @property
    def role(self) -> Role:
        """What it belongs to."""
        return Role.MEASUREMENT

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The rate along x, y and z, in mm/s."""
        return tuple(Parameter(f"{self.name}-{a}", "mm/s") for a in _AXES)

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 3"]:
        """Return the time since the middle, for each direction."""
        return (at.time_s - self.middle_s)[:, None, None] * np.eye(3)


class TableDriftFamily(Family):
    """One candidate."""

    name = "table-drift"
    in_machine = False
    signature = Signature(
        cause="The tracker's stand, the table or its clamping creeps, or the tracker "
        "had not warmed up.",
        looks_like="All lines shift evenly with time, whatever axis moves.",
        remedy="Let the tracker warm up and settle, clamp its base, close the path by "
        "measuring the first lines again.",
    )

    def candidates(self, at: Conditions) -> Sequence[Candidate]:
        """Return the drift."""
        span = max(float(np.ptp(at.time_s)), 1.0)
        middle = 0.5 * float(at.time_s.min() + at.time_s.max())
        usual = np.full(3, 2.0 * USUAL_MM / span)
        return [Candidate(self.name, {}, TableDrift(middle), usual)]

    def parameters(
        self,
        candidate: Candidate,
        theta: Float64[np.ndarray, "3"],
        covariance: Float64[np.ndarray, "3 3"],
        value_sigma: float,
    ) -> dict[str, Measured]:
        """Return the rates."""
        sigma = np.sqrt(np.diag(covariance))
        return {
            f"rate_um_per_s[{a}]": Measured(float(t) * 1e3, float(s) * 1e3)
            for a, t, s in zip(_AXES, theta, sigma, strict=True)
        }
