"""Acceleration of an axis: its carriage leans, with all that it carries.

Only samples on ramps show it. Every estimate that uses them includes it: near the ends
of lines it would be taken for error motions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from truepath.kinematics.conditions import Conditions
from truepath.kinematics.effects.base import Effect, Parameter, QuadraticPrior, Role
from truepath.kinematics.effects.error_motion import find_arm
from truepath.kinematics.machine.machine import LinearAxis
from truepath.kinematics.machine.symbols import is_turn, list_error_motions

_UNIT_MM_S2 = 1000.0
# At 1 m/s²: more than carriages bend, so that data alone determine the size.
_USUAL_MM, _USUAL_RAD = 0.005, 1.5e-5


@dataclass(frozen=True)
class InertialBend(Effect):
    """The six error motions of an axis at an acceleration of 1 m/s²."""

    kind = "inertial-bend"
    role = Role.NUISANCE
    axis: LinearAxis

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """One per error motion."""
        return tuple(
            Parameter(f"{self.name}-{symbol}", "rad" if is_turn(symbol) else "mm")
            for symbol in list_error_motions(self.axis.name)
        )

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 p"]:
        """Arms of the error motions, times the acceleration in m/s²."""
        columns = np.zeros((len(at), 3, len(self.parameters)))
        share = at.axis_acceleration(self.axis.name) / _UNIT_MM_S2
        moving = np.flatnonzero(share)
        if len(moving):
            for k, symbol in enumerate(list_error_motions(self.axis.name)):
                arm = find_arm(symbol, at)[moving]
                columns[moving, :, k] = arm * share[moving, None]
        return columns

    def prior(self) -> QuadraticPrior:
        """Typical bends of carriages, as standard deviations."""
        sigma = [
            _USUAL_RAD if is_turn(symbol) else _USUAL_MM
            for symbol in list_error_motions(self.axis.name)
        ]
        form = np.diag(np.array(sigma) ** -2.0)
        return QuadraticPrior(form, len(sigma), float(len(sigma)), is_known=True)
