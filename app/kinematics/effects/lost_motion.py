"""Lost motion of an axis in its own direction, and error motions that it tilts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float64

from app.kinematics.effects.approach import half_width
from app.kinematics.effects.base import Conditions, Effect
from app.kinematics.effects.catalogue import (
    USUAL_MM,
    Candidate,
    Family,
    Measured,
    Signature,
)
from app.kinematics.machine import Machine
from app.kinematics.symbols import error_motions, is_positioning, is_turn

_USUAL_RAD = 1e-5


class BacklashFamily(Family):
    """One candidate an axis."""

    name = "backlash"
    signature = Signature(
        cause="Play or wind-up in screw, nut, thrust bearing or rack.",
        looks_like="An axis stops short by the same width whenever it comes from the "
        "other side: lines lie apart by direction of travel.",
        remedy="Enter the width as the axis' backlash compensation; check nut preload "
        "and thrust bearing, or measure with a scale.",
    )

    def candidates(self, at: Conditions) -> Sequence[Candidate]:
        """Return one an axis."""
        return [
            Candidate(
                self.name,
                {"axis": axis.name},
                half_width(f"E{axis.name}{axis.name}", axis),
                np.array([0.5 * USUAL_MM]),
            )
            for axis in at.machine.linear_axes
        ]

    def restored(
        self, machine: Machine, keys: Mapping[str, str], numbers: Mapping[str, float]
    ) -> Effect:
        """Return the effect as a model file states it."""
        axis = machine.linear(keys["axis"])
        return half_width(f"E{axis.name}{axis.name}", axis)

    def parameters(
        self,
        candidate: Candidate,
        theta: Float64[np.ndarray, "1"],
        covariance: Float64[np.ndarray, "1 1"],
        value_sigma: float,
    ) -> dict[str, Measured]:
        """Return the width: coming from below, the axis stops short by half of it."""
        sigma = float(np.sqrt(covariance[0, 0]))
        return {"width_um": Measured(-2e3 * float(theta[0]), 2e3 * sigma)}


class LateralBacklashFamily(Family):
    """One candidate an error motion across or about an axis."""

    name = "lateral-backlash"
    signature = Signature(
        cause="A carriage has play in its guide, or is pushed aside by a nut or chain "
        "that is off centre: it tilts or shifts as it turns back.",
        looks_like="A straightness or an angle has two values at each place, one for "
        "each direction of approach.",
        remedy="Check guide clearance, gibs and preload; approach from one side, or "
        "enter tables of both directions.",
    )

    def candidates(self, at: Conditions) -> Sequence[Candidate]:
        """Return one for each error motion but positioning."""
        return [
            Candidate(
                self.name,
                {"axis": axis.name, "motion": symbol},
                half_width(symbol, axis),
                np.array([_USUAL_RAD if is_turn(symbol) else 0.5 * USUAL_MM]),
            )
            for axis in at.machine.linear_axes
            for symbol in error_motions(axis.name)
            if not is_positioning(symbol)
        ]

    def restored(
        self, machine: Machine, keys: Mapping[str, str], numbers: Mapping[str, float]
    ) -> Effect:
        """Return the effect as a model file states it."""
        axis, symbol = machine.linear(keys["axis"]), keys["motion"]
        if symbol not in error_motions(axis.name):
            raise KeyError(symbol)
        return half_width(symbol, axis)

    def parameters(
        self,
        candidate: Candidate,
        theta: Float64[np.ndarray, "1"],
        covariance: Float64[np.ndarray, "1 1"],
        value_sigma: float,
    ) -> dict[str, Measured]:
        """Return half the difference between both directions, in µm or µrad."""
        turn = is_turn(candidate.keys["motion"])
        scale = 1e6 if turn else 1e3
        sigma = float(np.sqrt(covariance[0, 0]))
        return {"half_width": Measured(scale * float(theta[0]), scale * sigma)}
