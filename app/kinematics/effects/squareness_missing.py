"""A squareness that the model in use has left out, or that has changed since."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float64

from app.kinematics.conditions import Conditions
from app.kinematics.effects.base import Effect
from app.kinematics.effects.catalogue import Candidate, Family, Measured, Signature
from app.kinematics.effects.squareness import squareness_between
from app.kinematics.machine import Machine

_USUAL_RAD = 2e-5


class SquarenessFamily(Family):
    """One candidate a pair of straight axes.

    The rigid-body model has all of them and leaves nothing to find.
    """

    name = "squareness"
    signature = Signature(
        cause="Two axes are not square to each other: as assembled, after a crash, or "
        "because the machine was levelled anew.",
        looks_like="Lines across the plane of the two axes lean in proportion to the "
        "travel of one of them; face diagonals differ in length.",
        remedy="Enter the angle as squareness compensation; check levelling and the "
        "joint between the two axes.",
    )

    def candidates(self, at: Conditions) -> Sequence[Candidate]:
        """Return one a pair of axes."""
        names = tuple(axis.name for axis in at.machine.linear_axes)
        return [
            Candidate(self.name, {"symbol": s.symbol}, s, np.array([_USUAL_RAD]))
            for s in squareness_between(names)
        ]

    def restored(
        self, machine: Machine, keys: Mapping[str, str], numbers: Mapping[str, float]
    ) -> Effect:
        """Return the squareness as a model file states it."""
        names = tuple(axis.name for axis in machine.linear_axes)
        known = {s.symbol: s for s in squareness_between(names)}
        return known[keys["symbol"]]

    def parameters(
        self,
        candidate: Candidate,
        theta: Float64[np.ndarray, "1"],
        covariance: Float64[np.ndarray, "1 1"],
        value_sigma: float,
    ) -> dict[str, Measured]:
        """Return the angle."""
        return {"value_urad": Measured.only(theta, covariance, 1e6)}
