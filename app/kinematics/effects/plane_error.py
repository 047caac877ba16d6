"""A displacement that depends on two axes at once: non-rigid behaviour at large.

Bicubic in the positions of two axes, without what depends on one of them alone: that is
what error motions hold already (the surface that brunn-hanebeck-2005 leaves to future
work).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Float64
from numpy.polynomial import legendre

from app.kinematics.conditions import Conditions
from app.kinematics.effects.base import Effect, Parameter, Role
from app.kinematics.effects.catalogue import (
    USUAL_MM,
    Candidate,
    Described,
    Measured,
    Signature,
)
from app.kinematics.machine import LinearAxis, Machine
from app.kinematics.symbols import DIRECTION, LINEAR

_DEGREE = 3
_PAIRS = [(i, j) for i in range(1, _DEGREE + 1) for j in range(1, _DEGREE + 1)]


@dataclass(frozen=True)
class PlaneError(Effect):
    """Products of Legendre polynomials of two positions, in one direction."""

    first: LinearAxis
    second: LinearAxis
    direction: str

    @property
    def name(self) -> str:
        """Name in the provenance of an estimate."""
        return f"plane-error-{self.first.name}{self.second.name}-{self.direction}"

    @property
    def role(self) -> Role:
        """What it belongs to."""
        return Role.STRUCTURE

    @property
    def axis_pair(self) -> tuple[str, str]:
        """Both axes of the plane."""
        return self.first.name, self.second.name

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """One for each product, in mm."""
        return tuple(Parameter(f"{self.name}-{i}{j}", "mm") for i, j in _PAIRS)

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 9"]:
        """Return the direction times the products."""
        one, two = (_legendre(axis, at) for axis in (self.first, self.second))
        columns = np.stack([one[:, i] * two[:, j] for i, j in _PAIRS], axis=1)
        unit = np.eye(3)[DIRECTION[self.direction]]
        return columns[:, None, :] * unit[None, :, None]


def _legendre(axis: LinearAxis, at: Conditions) -> Float64[np.ndarray, "n d"]:
    share = (at.axis_mm(axis.name) - axis.min_mm) / (axis.max_mm - axis.min_mm)
    return legendre.legvander(2.0 * share - 1.0, _DEGREE)


class PlaneErrorFamily(Described):
    """Every plane and direction."""

    name = "plane-error"
    signature = Signature(
        cause="Structure that gives way under moving loads in a way no single beam "
        "explains.",
        looks_like="An error that depends on where two axes stand at once.",
        remedy="Compensate with a grid of the plane or volume instead of single axes.",
    )

    def candidates(self, at: Conditions) -> Sequence[Candidate]:
        """Return one for each pair of axes and direction."""
        falling = np.array([1.0 / (i * j) for i, j in _PAIRS])
        return [
            Candidate(
                self.name,
                {"plane": first.name + second.name, "direction": direction},
                PlaneError(first, second, direction),
                USUAL_MM * falling,
            )
            for first, second in combinations(at.machine.linear_axes, 2)
            for direction in LINEAR
        ]

    def restored(
        self, machine: Machine, keys: Mapping[str, str], numbers: Mapping[str, float]
    ) -> Effect:
        """Return the effect as a model file states it."""
        first, second = (machine.linear(name) for name in keys["plane"])
        return PlaneError(first, second, keys["direction"])

    def parameters(
        self,
        candidate: Candidate,
        theta: Float64[np.ndarray, "9"],
        covariance: Float64[np.ndarray, "9 9"],
        value_sigma: float,
    ) -> dict[str, Measured]:
        """Return the root mean square over the plane."""
        weight = np.array([1.0 / ((2 * i + 1) * (2 * j + 1)) for i, j in _PAIRS])
        rms = float(np.sqrt(np.sum(weight * theta**2)))
        slope = weight * theta / max(rms, 1e-300)
        sigma = float(np.sqrt(slope @ covariance @ slope))
        return {"rms_um": Measured(rms * 1e3, sigma * 1e3)}

    def depends_on(self, candidate: Candidate) -> list[str]:
        """Return both axes."""
        return list(candidate.keys["plane"])

    def told(self, candidate: Candidate, found: Mapping[str, Measured]) -> str:
        """Return direction, size and both axes."""
        one, two = candidate.keys["plane"]
        return (
            f"a displacement along {candidate.keys['direction']} of "
            f"{found['rms_um'].value:.2g} µm (root mean square) that depends on "
            f"{one} and {two} together"
        )
