"""A slow shift of everything with time that is neither steady nor a step nor a wave."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.kinematics.conditions import Conditions
from app.kinematics.effects.base import Effect, Parameter, Role, along
from app.kinematics.effects.catalogue import (
    USUAL_MM,
    Candidate,
    Described,
    Measured,
    Signature,
)
from app.kinematics.symbols import LINEAR

_HALF_WAVES = 12


@dataclass(frozen=True)
class TimeWander(Effect):
    """A cosine series over the run, in one direction."""

    direction: str
    first_s: float
    span_s: float

    @property
    def name(self) -> str:
        """Name in the provenance of an estimate."""
        return f"time-wander-{self.direction}"

    @property
    def role(self) -> Role:
        """What it belongs to."""
        return Role.STRUCTURE

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """One for each number of half waves in the run, in mm."""
        return tuple(
            Parameter(f"{self.name}-{k}", "mm") for k in range(1, _HALF_WAVES + 1)
        )

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 p"]:
        """Return the direction times the cosines."""
        angle = np.pi * (at.time_s - self.first_s) / self.span_s
        series = np.cos(angle[:, None] * np.arange(1, _HALF_WAVES + 1))
        return along(self.direction, series)


class TimeWanderFamily(Described):
    """Every direction."""

    name = "time-wander"
    in_machine = False
    signature = Signature(
        cause="Mount, table or air that wanders: sun, draught, a hall that cools.",
        looks_like="All points shift slowly to and fro with time, whatever axis moves.",
        remedy="Let all settle, shield it from draught and sun, measure faster; repeat "
        "lines to see it.",
    )

    def candidates(self, at: Conditions) -> Sequence[Candidate]:
        """Return one a direction; the slower a wave, the higher it usually is."""
        first_s, span_s = float(at.time_s.min()), max(float(np.ptp(at.time_s)), 1.0)
        usual = USUAL_MM / np.arange(1, _HALF_WAVES + 1)
        return [
            Candidate(
                self.name, {"direction": d}, TimeWander(d, first_s, span_s), usual
            )
            for d in LINEAR
        ]

    def parameters(
        self,
        candidate: Candidate,
        theta: Float64[np.ndarray, " p"],
        covariance: Float64[np.ndarray, "p p"],
        value_sigma: float,
    ) -> dict[str, Measured]:
        """Return the root mean square over the run."""
        rms = float(np.sqrt(0.5 * np.sum(theta**2)))
        slope = 0.5 * theta / max(rms, 1e-300)
        sigma = float(np.sqrt(slope @ covariance @ slope))
        return {"rms_um": Measured(rms * 1e3, sigma * 1e3)}

    def depends_on(self, candidate: Candidate) -> list[str]:
        """Return the time."""
        return ["t"]

    def told(self, candidate: Candidate, found: Mapping[str, Measured]) -> str:
        """Return direction and size."""
        return (
            f"a slow wander along {candidate.keys['direction']} of "
            f"{found['rms_um'].value:.2g} µm (root mean square)"
        )
