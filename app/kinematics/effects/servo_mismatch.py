"""An axis that lags behind its command by more than the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.kinematics.conditions import Conditions
from app.kinematics.effects.base import Effect, Parameter
from app.kinematics.effects.catalogue import Candidate, Family, Measured, Signature
from app.kinematics.effects.error_motion import arm_of
from app.kinematics.machine import LinearAxis, Machine

_USUAL_S = 1e-4


@dataclass(frozen=True)
class ServoMismatch(Effect):
    """Following error of one axis: its speed times a lag."""

    axis: LinearAxis

    @property
    def name(self) -> str:
        """Name in the provenance of an estimate."""
        return f"servo-mismatch-{self.axis.name}"

    @property
    def lag_axis(self) -> str:
        """Its axis."""
        return self.axis.name

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The lag, in s."""
        return (Parameter(self.name, "s"),)

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 1"]:
        """Return how far the axis is behind for each second of lag."""
        if at.recorded is None:
            return np.zeros((len(at), 3, 1))
        rate = at.recorded.rate[:, at.machine.axis_names.index(self.axis.name)]
        arm = arm_of(f"E{self.axis.name}{self.axis.name}", at)
        return -(arm * rate[:, None])[:, :, None]


class ServoMismatchFamily(Family):
    """One candidate an axis that moves together with others."""

    name = "servo-mismatch"
    signature = Signature(
        cause="The position loops of the axes are not matched: one has another gain or "
        "feed-forward.",
        looks_like="Lines of several axes are displaced sideways in proportion to "
        "that axis' speed, to the other side on the way back; nothing at standstill.",
        remedy="Match the servo gains (kv) and feed-forward of the axes; run a "
        "circular test to confirm.",
    )

    def candidates(self, at: Conditions) -> Sequence[Candidate]:
        """Return one an axis; none where nothing is measured in motion."""
        if at.recorded is None or not at.recorded.rate.any():
            return []
        return [
            Candidate(
                self.name,
                {"axis": axis.name},
                ServoMismatch(axis),
                np.array([_USUAL_S]),
            )
            for axis in at.machine.linear_axes
        ]

    def restored(
        self, machine: Machine, keys: Mapping[str, str], numbers: Mapping[str, float]
    ) -> Effect:
        """Return the effect as a model file states it."""
        return ServoMismatch(machine.linear(keys["axis"]))

    def parameters(
        self,
        candidate: Candidate,
        theta: Float64[np.ndarray, "1"],
        covariance: Float64[np.ndarray, "1 1"],
        value_sigma: float,
    ) -> dict[str, Measured]:
        """Return the lag."""
        return {"lag_ms": Measured.only(theta, covariance, 1e3)}
