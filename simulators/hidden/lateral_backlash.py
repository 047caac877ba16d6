"""A carriage with play in its guide: friction leans it to one side or the other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from truepath.simulators.hidden.effect import HiddenEffect, Occasion, error_motion
from truepath.simulators.hidden.motion import Motion

_ARM_M = 0.33  # a turn is drawn so that it moves the tool as far as a shift does


@dataclass(frozen=True, slots=True)
class LateralBacklash(HiddenEffect):
    """Going up the carriage leans by +h, going down by −h.

    motion : the error motion it leans in; half_width : h in µm or µrad
    turnover_mm : travel after a reversal in which it leans over
    """

    name = "lateral-backlash"
    axis: str
    motion: str
    half_width: float
    turnover_mm: float = 0.5

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Draw a straightness or an angle; an angle acts over a third of a metre."""
        axis = occasion.axis(rng)
        letter = str(rng.choice([c for c in "XYZABC" if c != axis]))
        half = occasion.size_um * float(rng.choice([-1.0, 1.0]))
        if letter in "ABC":
            half /= _ARM_M
        return cls(axis, f"E{letter}{axis}", half, float(rng.uniform(0.1, 1.0)))

    @property
    def _turns(self) -> bool:
        return self.motion[1] in "ABC"

    def carry(self, motion: Motion, time_s: np.ndarray) -> dict[str, np.ndarray]:
        """Return how far it leans, by how much of the play friction has crossed."""
        half_mm = 0.5 * self.turnover_mm
        follows = motion.play_mm(self.axis, half_mm, time_s)
        lean = (motion.position_mm(self.axis, time_s) - follows) / half_mm
        unit = 1e-6 if self._turns else 1e-3
        return error_motion(self.motion, unit * self.half_width * lean)
