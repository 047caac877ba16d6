"""A short excursion after an axis has reversed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.kinematics.conditions import Conditions
from app.kinematics.effects.base import Effect, Parameter
from app.kinematics.effects.catalogue import (
    USUAL_MM,
    Candidate,
    Family,
    Measured,
    Scan,
    Signature,
)
from app.kinematics.effects.error_motion import arm_of
from app.kinematics.machine import LinearAxis, Machine

_DECAYS_MM = np.geomspace(3.0, 60.0, 10)


@dataclass(frozen=True)
class ReversalSpike(Effect):
    """Displacement in one direction that decays with the distance since reversal.

    It turns over with the direction that the axis now goes in.
    """

    axis: LinearAxis
    direction: str
    decay_mm: float

    @property
    def name(self) -> str:
        """Name in the provenance of an estimate."""
        return f"reversal-spike-{self.axis.name}-{self.direction}-{self.decay_mm:.4g}"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The excursion at the reversal, in mm."""
        return (Parameter(self.name, "mm"),)

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 1"]:
        """Return the direction times what is left of the excursion."""
        if at.recorded is None:
            return np.zeros((len(at), 3, 1))
        column = at.machine.axis_names.index(self.axis.name)
        left = np.exp(-at.recorded.since_reversal[:, column] / self.decay_mm)
        arm = arm_of(f"E{self.direction}{self.axis.name}", at)
        return (arm * (left * at.approach[:, column])[:, None])[:, :, None]


class ReversalSpikeFamily(Family):
    """Every axis in every direction, the decay scanned."""

    name = "reversal-spike"
    scanned = "decay_mm"
    signature = Signature(
        cause="Friction holds an axis back for a moment when it reverses, or its guide "
        "tilts before it settles.",
        looks_like="A peak just after each reversal that fades within some millimetres "
        "of travel; on circles, a spike at the change of quadrant.",
        remedy="Tune the controller's friction (quadrant error) compensation; check "
        "lubrication and the preload of guides and nut.",
    )

    def candidates(self, at: Conditions) -> Sequence[Candidate]:
        """Return one for each axis that reverses, and direction."""
        if at.recorded is None:
            return []
        names = [axis.name for axis in at.machine.linear_axes]
        return [
            Candidate(
                self.name,
                {"axis": axis.name, "direction": direction},
                ReversalSpike(axis, direction, 10.0),
                np.array([USUAL_MM]),
                10.0,
            )
            for axis in at.machine.linear_axes
            for direction in names
            if self._reverses(axis, at)
        ]

    @staticmethod
    def _reverses(axis: LinearAxis, at: Conditions) -> bool:
        column = at.machine.axis_names.index(axis.name)
        recorded = at.recorded
        return recorded is not None and bool(
            (recorded.since_reversal[:, column] < _DECAYS_MM[-1]).any()
        )

    def scan(self, candidate: Candidate, at: Conditions) -> Scan:
        """Return decays."""
        return Scan(self.scanned, _DECAYS_MM)

    def restored(
        self, machine: Machine, keys: Mapping[str, str], numbers: Mapping[str, float]
    ) -> Effect:
        """Return the effect as a model file states it."""
        axis = machine.linear(keys["axis"])
        return ReversalSpike(axis, keys["direction"], numbers[self.scanned])

    def parameters(
        self,
        candidate: Candidate,
        theta: Float64[np.ndarray, "1"],
        covariance: Float64[np.ndarray, "1 1"],
        value_sigma: float,
    ) -> dict[str, Measured]:
        """Return amplitude and decay."""
        return {
            "amplitude_um": Measured.only(theta, covariance, 1e3),
            self.scanned: Measured(candidate.value or 0.0, value_sigma),
        }
