"""Effects of speed, reversals and drives on the axes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from truepath_simulators.hidden.effect import (
    HiddenEffect,
    Occasion,
    along,
    error_motion,
)
from truepath_simulators.hidden.motion import Motion
from truepath_simulators.machine.tracker_head import TrackerClock


# A position loop with more lag than those of the other axes.
@dataclass(frozen=True, slots=True)
class ServoMismatch(HiddenEffect):
    """A first-order lag of one axis, ramps included; a positive lag is late."""

    name = "servo-mismatch"
    axis: str
    lag_ms: float

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Random axis; at typical feed it lags, or leads, by the size."""
        lag_ms = occasion.size_um / occasion.feed_mm_s * float(rng.choice([-1.0, 1.0]))
        return cls(occasion.axis(rng), lag_ms)

    def added_error_motions(
        self, motion: Motion, time_s: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Following error, r − c of lag r' = c − r.

        For a command c of cubic pieces r − c = −lag c' + lag² c'' − lag³ c'''; the
        begin of a piece excites a jump of lag³ c''', for 0.1 ms less than 0.1 nm.
        """
        lag_s = 1e-3 * self.lag_ms
        velocity, acceleration, jerk = motion.derivatives(self.axis, time_s)
        behind = lag_s * (velocity - lag_s * (acceleration - lag_s * jerk))
        return error_motion(f"E{self.axis}{self.axis}", -behind)


# An axis that sticks when it turns back, and recovers within some millimetres.
@dataclass(frozen=True, slots=True)
class ReversalSpike(HiddenEffect):
    """An excursion that fades with the travel since the reversal.

    It has the sign of the axis' direction after the reversal.
    """

    name = "reversal-spike"
    axis: str
    direction: str
    amplitude_um: float
    decay_mm: float

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Random axis, direction and decay length."""
        return cls(
            occasion.axis(rng),
            str(rng.choice(list("XYZ"))),
            occasion.size_um * float(rng.choice([-1.0, 1.0])),
            float(rng.uniform(5.0, 30.0)),
        )

    def added_error_motions(
        self, motion: Motion, time_s: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Remaining part of the excursion."""
        travel, sign = motion.since_reversal_mm(self.axis, time_s)
        left = 1e-3 * self.amplitude_um * sign * np.exp(-travel / self.decay_mm)
        return error_motion(f"E{self.direction}{self.axis}", left)


# A carriage that leans back while its axis speeds up, and forward while it brakes.
_USUAL_M_S2 = 1.5  # at which it has the requested size
_ARM_MM = 300.0
_PIECES = 28  # of the past whose oscillation has not decayed


@dataclass(frozen=True, slots=True)
class InertialBend(HiddenEffect):
    """An error motion in proportion to the acceleration of its axis.

    motion : `EYX`, `ECX` …; amount : µm or µrad at 1 m/s²
    frequency_hz : of the oscillation after each change of the acceleration; 0 for a
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
        """Random lateral motion or turn, of the size at typical acceleration."""
        axis = occasion.axis(rng)
        kind = str(rng.choice([k for k in "XYZABC" if k != axis]))
        arm_m = 1e-3 * _ARM_MM if kind in "ABC" else 1.0
        sign = float(rng.choice([-1.0, 1.0]))
        return cls(f"E{kind}{axis}", sign * occasion.size_um / _USUAL_M_S2 / arm_m)

    @property
    def keys(self) -> dict[str, str]:
        """Its axis and motion."""
        return {"axis": self.motion[2], "motion": self.motion}

    def added_error_motions(
        self, motion: Motion, time_s: np.ndarray
    ) -> dict[str, np.ndarray]:
        """The motion: a mass on a spring under the acceleration."""
        _, acceleration, jerk = motion.derivatives(self.motion[2], time_s)
        if self.frequency_hz:
            lag_s = 2.0 * self.damping / (2.0 * np.pi * self.frequency_hz)
            acceleration = acceleration - lag_s * jerk + self._swing(motion, time_s)
        unit = 1e-6 if self.motion[1] in "ABC" else 1e-3
        return error_motion(self.motion, unit * self.amount * 1e-3 * acceleration)

    def _swing(self, motion: Motion, time_s: np.ndarray) -> np.ndarray:
        """Response to each change of the jerk J, as an acceleration.

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


# A pump, a fan or a drive that shakes table or tracker.
_SLOWEST_HZ, _FASTEST_HZ = 1.0, 80.0


@dataclass(frozen=True, slots=True)
class Vibration(HiddenEffect):
    """amplitude sin(2π f t + phase) in one direction."""

    name = "vibration"
    direction: str
    frequency_hz: float
    amplitude_um: float
    phase_rad: float = 0.0

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Random direction and frequency, uniform in its logarithm."""
        low, high = np.log(_SLOWEST_HZ), np.log(_FASTEST_HZ)
        return cls(
            str(rng.choice(list("XYZ"))),
            float(np.exp(rng.uniform(low, high))),
            occasion.size_um,
            float(rng.uniform(0.0, 2.0 * np.pi)),
        )

    def parameters(self, clock: TrackerClock) -> dict[str, float]:
        """Frequency, on the tracker's clock, and amplitude."""
        return {
            "frequency_hz": self.frequency_hz / (1.0 + clock.drift),
            "amplitude_um": self.amplitude_um,
        }

    def common_shift_mm(self, motion: Motion, time_s: np.ndarray) -> np.ndarray:
        """The wave, mm."""
        del motion
        angle = 2.0 * np.pi * self.frequency_hz * time_s + self.phase_rad
        return along(self.direction, 1e-3 * self.amplitude_um * np.sin(angle))
