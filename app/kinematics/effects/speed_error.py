"""A displacement that depends on how fast an axis moves, whichever way it goes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.kinematics.conditions import Conditions
from app.kinematics.effects.base import Effect, Parameter, Role
from app.kinematics.effects.catalogue import (
    USUAL_MM,
    Candidate,
    Described,
    Measured,
    Signature,
    rate_of,
)
from app.kinematics.effects.error_motion import arm_of
from app.kinematics.machine import LinearAxis, Machine

_FASTEST = "fastest_mm_s"
_LEAST_SPREAD = 0.1  # of the highest speed: less tells nothing of speed


@dataclass(frozen=True)
class SpeedError(Effect):
    """An error motion as speed and square of the speed.

    fastest_mm_s : the highest speed that is usual for the axis
    """

    axis: LinearAxis
    direction: str
    fastest_mm_s: float

    @property
    def name(self) -> str:
        """Name in the provenance of an estimate."""
        return f"speed-error-{self.axis.name}-{self.direction}"

    @property
    def role(self) -> Role:
        """What it belongs to."""
        return Role.STRUCTURE

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Displacement at the highest speed by speed, and by its square, in mm."""
        return tuple(Parameter(f"{self.name}-{p}", "mm") for p in ("v", "v2"))

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 2"]:
        """Return the direction times speed and its square."""
        speed = rate_of(at, self.axis.name) / self.fastest_mm_s
        arm = arm_of(f"E{self.direction}{self.axis.name}", at)
        return arm[:, :, None] * np.stack([speed, speed**2], axis=1)[:, None, :]


class SpeedErrorFamily(Described):
    """Every axis that goes at several speeds, and every direction."""

    name = "speed-error"
    signature = Signature(
        cause="A slide that floats up on its oil, or a drive that pulls it aside, the "
        "more the faster it goes.",
        looks_like="Lines lie apart by the speed of an axis, alike on the way there "
        "and back.",
        remedy="Measure at the feed that parts are finished at; check way oil and the "
        "preload of the guide.",
    )

    def candidates(self, at: Conditions) -> Sequence[Candidate]:
        """Return one for each axis and direction."""
        found: list[Candidate] = []
        for axis in at.machine.linear_axes:
            speed = rate_of(at, axis.name)
            fastest = float(speed.max(initial=0.0))
            if np.std(speed) <= _LEAST_SPREAD * fastest:
                continue
            found += [
                Candidate(
                    self.name,
                    {"axis": axis.name, "direction": other.name},
                    SpeedError(axis, other.name, fastest),
                    np.full(2, USUAL_MM),
                )
                for other in at.machine.linear_axes
            ]
        return found

    def kept(self, candidate: Candidate) -> dict[str, float]:
        """Return the highest speed."""
        return {_FASTEST: _effect(candidate).fastest_mm_s}

    def restored(
        self, machine: Machine, keys: Mapping[str, str], numbers: Mapping[str, float]
    ) -> Effect:
        """Return the effect as a model file states it."""
        axis = machine.linear(keys["axis"])
        return SpeedError(axis, keys["direction"], numbers[_FASTEST])

    def parameters(
        self,
        candidate: Candidate,
        theta: Float64[np.ndarray, "2"],
        covariance: Float64[np.ndarray, "2 2"],
        value_sigma: float,
    ) -> dict[str, Measured]:
        """Return the displacement at the highest speed."""
        sigma = float(np.sqrt(covariance.sum()))
        return {"amplitude_um": Measured(float(theta.sum()) * 1e3, sigma * 1e3)}

    def depends_on(self, candidate: Candidate) -> list[str]:
        """Return the axis' speed."""
        return [f"v({candidate.keys['axis']})"]

    def told(self, candidate: Candidate, found: Mapping[str, Measured]) -> str:
        """Return axis, direction and size at the highest speed."""
        keys, size = candidate.keys, found["amplitude_um"].value
        return (
            f"a displacement along {keys['direction']} that depends on how fast "
            f"{keys['axis']} moves, whichever way: {size:.2g} µm at "
            f"{_effect(candidate).fastest_mm_s:.3g} mm/s"
        )


def _effect(candidate: Candidate) -> SpeedError:
    effect = candidate.effect
    if not isinstance(effect, SpeedError):
        raise TypeError(f"{candidate.label} is no speed error")
    return effect
