"""A guide whose straightness waves with the pitch of its screws or rollers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from truepath.simulators.hidden.effect import HiddenEffect, Occasion, error_motion
from truepath.simulators.hidden.motion import Motion
from truepath.simulators.tracker_head import TrackerClock


@dataclass(frozen=True, slots=True)
class WavyGuide(HiddenEffect):
    """A rail drawn down by bolts of one pitch: the carriage rides over the waves."""

    name = "wavy-guide"
    in_catalogue = False
    axis: str
    direction: str
    pitch_mm: float
    amplitude_um: float
    phase_rad: float = 0.0

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Draw an axis, a direction across it, and a pitch."""
        axis = occasion.axis(rng)
        return cls(
            axis,
            str(rng.choice([d for d in "XYZ" if d != axis])),
            float(rng.uniform(8.0, 40.0)),
            occasion.size_um,
            float(rng.uniform(0.0, 2.0 * np.pi)),
        )

    def parameters(self, clock: TrackerClock) -> dict[str, float]:
        """Return pitch and amplitude."""
        del clock
        return {"period_mm": self.pitch_mm, "amplitude_um": self.amplitude_um}

    def carry(self, motion: Motion, time_s: np.ndarray) -> dict[str, np.ndarray]:
        """Return the height of the rail under the carriage."""
        run = motion.position_mm(self.axis, time_s) / self.pitch_mm
        wave = np.sin(2.0 * np.pi * run + self.phase_rad)
        return error_motion(
            f"E{self.direction}{self.axis}", 1e-3 * self.amplitude_um * wave
        )
