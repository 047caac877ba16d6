"""An effect that belongs to one of several Runs: where the tracker stood, a knock."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.kinematics.conditions import Conditions
from app.kinematics.effects.base import (
    Effect,
    Parameter,
    QuadraticPrior,
    Role,
    name_in_run,
)


@dataclass(frozen=True)
class EffectOfRun(Effect):
    """An effect in the Run of its number; nothing in all others."""

    role = Role.MEASUREMENT
    effect: Effect
    run: int

    def spell(self, digits: str) -> str:
        """Return the effect, with the number of its Run beyond the first."""
        return name_in_run(self.effect.spell(digits), self.run)

    @property
    def own_run(self) -> int:
        """The Run of its number."""
        return self.run

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Those of the effect."""
        return self.effect.parameters

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 p"]:
        """Return that of the effect in its own Run."""
        if at.run != self.run:
            return np.zeros((len(at), 3, len(self.parameters)))
        return self.effect.jacobian(at)

    def jacobian_in_time(
        self, time_s: Float64[np.ndarray, " n"]
    ) -> Float64[np.ndarray, "n 3 p"] | None:
        """Return those of the effect, at moments of its own Run."""
        return self.effect.jacobian_in_time(time_s)

    def prior(self) -> QuadraticPrior | None:
        """Return that of the effect."""
        return self.effect.prior()
