"""A knock against the tracker, its stand or the target's nest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from truepath.simulators.hidden.effect import HiddenEffect, Occasion
from truepath.simulators.hidden.motion import Motion
from truepath.simulators.tracker_head import TrackerClock


@dataclass(frozen=True, slots=True)
class SetupStep(HiddenEffect):
    """All points are shifted from one moment on.

    time_s : of the machine's clock
    """

    name = "setup-step"
    time_s: float
    step_um: tuple[float, float, float]

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Draw a moment in the middle two thirds; the step is twice the size."""
        direction = rng.normal(size=3)
        direction /= np.linalg.norm(direction)
        x, y, z = 2.0 * occasion.size_um * direction
        moment_s = float(rng.uniform(1.0 / 6.0, 5.0 / 6.0) * occasion.duration_s)
        return cls(moment_s, (float(x), float(y), float(z)))

    def parameters(self, clock: TrackerClock) -> dict[str, float | tuple[float, ...]]:
        """Return the moment on the tracker's clock, and the step."""
        return {"t_s": clock.device_s(self.time_s), "step_um": self.step_um}

    def shift_mm(self, motion: Motion, time_s: np.ndarray) -> np.ndarray:
        """Return the step after the moment."""
        del motion
        return 1e-3 * np.outer(time_s >= self.time_s, self.step_um)
