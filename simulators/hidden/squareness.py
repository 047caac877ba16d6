"""Two axes that are out of square since the model in use was made: a crash, a move."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from truepath.simulators.hidden.effect import HiddenEffect, Occasion
from truepath.simulators.hidden.motion import Motion
from truepath.simulators.joint import rotation_matrices
from truepath.simulators.machine_file import DIRECTIONS
from truepath.simulators.truth_machine import SQUARENESS


@dataclass(frozen=True, slots=True)
class Squareness(HiddenEffect):
    """The direction of travel of an axis is turned, as in the truth machine."""

    name = "squareness"
    needs_model: ClassVar[bool] = True
    symbol: str
    value_urad: float

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Draw a pair of axes; from end to end of its travel one leans twice the size.

        The tracker's place takes up the mean.
        """
        symbol = str(rng.choice(list(SQUARENESS)))
        travel_m = 1e-3 * occasion.travel_mm(SQUARENESS[symbol][0])
        sign = float(rng.choice([-1.0, 1.0]))
        return cls(symbol, sign * 2.0 * occasion.size_um / travel_m)

    def carry(self, motion: Motion, time_s: np.ndarray) -> dict[str, np.ndarray]:
        """Return s (R d − d) for the position s on the direction d of travel."""
        axis, around = SQUARENESS[self.symbol]
        angle = 1e-6 * self.value_urad
        turn = rotation_matrices(
            *(np.array([angle if name == around else 0.0]) for name in DIRECTIONS)
        )[0]
        direction = np.array(DIRECTIONS[axis])
        motions = np.zeros((len(time_s), 6))
        motions[:, :3] = np.outer(
            motion.position_mm(axis, time_s), turn @ direction - direction
        )
        return {axis: motions}
