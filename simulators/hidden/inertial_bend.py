"""A carriage that leans back while its axis speeds up, and forward while it brakes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from truepath.simulators.hidden.effect import HiddenEffect, Occasion, error_motion
from truepath.simulators.hidden.motion import Motion

_USUAL_M_S2 = 1.5  # at which it is as large as is asked for
_ARM_MM = 300.0
_PIECES = 28  # of the past, of which the swing is not over


@dataclass(frozen=True, slots=True)
class InertialBend(HiddenEffect):
    """An error motion in proportion to the acceleration of its axis.

    motion : `EYX`, `ECX` …; amount : µm or µrad at 1 m/s²
    frequency_hz : at which it swings after each change of the acceleration; 0 for a
        carriage that is stiff against the ramp
    """

    name = "inertial-bend"
    in_catalogue = False
    on_ramps_alone = True
    motion: str
    amount: float
    frequency_hz: float = 0.0
    damping: float = 0.05

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Draw a motion aside, or a turn, of the size at usual acceleration."""
        axis = occasion.axis(rng)
        kind = str(rng.choice([k for k in "XYZABC" if k != axis]))
        arm_m = 1e-3 * _ARM_MM if kind in "ABC" else 1.0
        sign = float(rng.choice([-1.0, 1.0]))
        return cls(f"E{kind}{axis}", sign * occasion.size_um / _USUAL_M_S2 / arm_m)

    @property
    def keys(self) -> dict[str, str]:
        """Its axis and motion."""
        return {"axis": self.motion[2], "motion": self.motion}

    def carry(self, motion: Motion, time_s: np.ndarray) -> dict[str, np.ndarray]:
        """Return the motion: a mass on a spring that the acceleration pulls."""
        _, acceleration, jerk = motion.derivatives(self.motion[2], time_s)
        if self.frequency_hz:
            lag_s = 2.0 * self.damping / (2.0 * np.pi * self.frequency_hz)
            acceleration = acceleration - lag_s * jerk + self._swing(motion, time_s)
        unit = 1e-6 if self.motion[1] in "ABC" else 1e-3
        return error_motion(self.motion, unit * self.amount * 1e-3 * acceleration)

    def _swing(self, motion: Motion, time_s: np.ndarray) -> np.ndarray:
        """Return what each change of the jerk J excites, as an acceleration.

        y'' + 2 d w y' + w^2 y = w^2 a answers to a = J t with
        J (t - 2 d / w + exp(-d w t) (2 d / w cos v t + (2 d^2 - 1) / v sin v t)),
        v = w sqrt(1 - d^2).
        """
        timeline, d = motion.timeline, self.damping
        w = 2.0 * np.pi * self.frequency_hz
        v = w * np.sqrt(1.0 - d**2)
        jerk = timeline.jerk * timeline.direction[:, motion.column(self.motion[2])]
        change = np.diff(jerk, prepend=0.0)
        now = np.searchsorted(timeline.start_s, time_s, side="right") - 1
        total = np.zeros(len(time_s))
        for back in range(_PIECES):
            piece = np.maximum(now - back, 0)
            since = np.maximum(time_s - timeline.start_s[piece], 0.0)
            wave = 2.0 * d / w * np.cos(v * since)
            wave += (2.0 * d**2 - 1.0) / v * np.sin(v * since)
            fresh = np.where(now >= back, change[piece], 0.0)
            total += fresh * np.exp(-d * w * since) * wave
        return total
