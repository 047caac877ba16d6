"""A guide that bends under another axis' carriage: no rigid body does it.

A beam on two supports gives way most in its middle, and by the share of the weight that
rests on it: that share grows with the other axis' position. In one direction the
displacement is −amplitude · 4u(1 − u) · v, with u along the guide and v along the
carriage's travel, both from 0 to 1. A heavy carriage makes the deflection under itself
that of a travelling load, (4u(1 − u))².
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.kinematics.conditions import Conditions
from app.kinematics.effects.base import Effect, Parameter, along
from app.kinematics.effects.catalogue import (
    USUAL_MM,
    Candidate,
    Family,
    Measured,
    Signature,
)
from app.kinematics.machine import LinearAxis, Machine
from app.kinematics.symbols import LINEAR


@dataclass(frozen=True)
class ElasticSag(Effect):
    """Displacement in one direction by the product of two positions."""

    axis: LinearAxis
    by: LinearAxis
    direction: str

    @property
    def name(self) -> str:
        """Name in the provenance of an estimate."""
        return f"elastic-sag-{self.axis.name}-{self.by.name}-{self.direction}"

    @property
    def axis_pair(self) -> tuple[str, str]:
        """Guide and carriage."""
        return self.axis.name, self.by.name

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The displacement at mid guide under the carriage's far end, in mm."""
        return (Parameter(self.name, "mm"),)

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 1"]:
        """Return the direction times the product."""
        u, v = (_share(axis, at) for axis in (self.axis, self.by))
        return along(self.direction, (-4.0 * u * (1.0 - u) * v)[:, None])


def _share(axis: LinearAxis, at: Conditions) -> Float64[np.ndarray, " n"]:
    return (at.axis_mm(axis.name) - axis.min_mm) / (axis.max_mm - axis.min_mm)


class ElasticSagFamily(Family):
    """Every pair of axes and direction."""

    name = "elastic-sag"
    signature = Signature(
        cause="A guide or cross beam bends under the carriage that travels on it, or "
        "under what hangs from it.",
        looks_like="The straightness or positioning of one axis depends on where "
        "another stands: tables of single axes cannot show it.",
        remedy="Use the controller's cross-axis (sag) compensation for the pair; check "
        "counterbalance and levelling.",
    )

    def candidates(self, at: Conditions) -> Sequence[Candidate]:
        """Return one for each ordered pair and direction."""
        axes = at.machine.linear_axes
        return [
            Candidate(
                self.name,
                {"axis": axis.name, "by": by.name, "direction": direction},
                ElasticSag(axis, by, direction),
                np.array([2.0 * USUAL_MM]),
            )
            for axis in axes
            for by in axes
            if by is not axis
            for direction in LINEAR
        ]

    def restored(
        self, machine: Machine, keys: Mapping[str, str], numbers: Mapping[str, float]
    ) -> Effect:
        """Return the effect as a model file states it."""
        return ElasticSag(
            machine.linear(keys["axis"]), machine.linear(keys["by"]), keys["direction"]
        )

    def parameters(
        self,
        candidate: Candidate,
        theta: Float64[np.ndarray, "1"],
        covariance: Float64[np.ndarray, "1 1"],
        value_sigma: float,
    ) -> dict[str, Measured]:
        """Return the amplitude."""
        return {"amplitude_um": Measured.only(theta, covariance, 1e3)}
