"""Drives: play, wear, lag, errors that repeat with every turn, and effects of speed.

A rotary axis that carries the workpiece: a lag of its angle turns the tool the other
way relative to the workpiece.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from truepath_simulators.hidden.effect import (
    HiddenEffect,
    Motions,
    Occasion,
    along,
    error_motion,
)
from truepath_simulators.hidden.motion import Motion
from truepath_simulators.machine.tracker_head import TrackerClock


# Lost motion: the nut has play, the table follows when the screw has crossed it.
@dataclass(frozen=True, slots=True)
class Backlash(HiddenEffect):
    """Play of an axis in its own direction; positive widths lose motion."""

    name = "backlash"
    axis: str
    width_um: float

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Random axis; half of the width to either side."""
        return cls(occasion.axis(rng), 2.0 * occasion.size_um)

    def added_error_motions(self, motion: Motion, time_s: np.ndarray) -> Motions:
        table = motion.play_mm(self.axis, 0.5e-3 * self.width_um, time_s)
        off = table - motion.position_mm(self.axis, time_s)
        return error_motion(f"E{self.axis}{self.axis}", off)


# A carriage with play in its guide: friction leans it to one side or the other.
_ARM_M = 0.33  # a turn moves the tool as far as a shift


@dataclass(frozen=True, slots=True)
class LateralBacklash(HiddenEffect):
    """The carriage leans by +h on the way up, by −h on the way down.

    motion : the error motion of the lean; half_width : h in µm or µrad
    turnover_mm : travel after a reversal in which the lean changes sides
    """

    name = "lateral-backlash"
    axis: str
    motion: str
    half_width: float
    turnover_mm: float = 0.5

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Random straightness or angle; an angle acts over a third of a metre."""
        axis = occasion.axis(rng)
        letter = str(rng.choice([c for c in "XYZABC" if c != axis]))
        half = occasion.size_um * float(rng.choice([-1.0, 1.0]))
        if letter in "ABC":
            half /= _ARM_M
        return cls(axis, f"E{letter}{axis}", half, float(rng.uniform(0.1, 1.0)))

    @property
    def _turns(self) -> bool:
        return self.motion[1] in "ABC"

    def added_error_motions(self, motion: Motion, time_s: np.ndarray) -> Motions:
        half_mm = 0.5 * self.turnover_mm
        follows = motion.play_mm(self.axis, half_mm, time_s)
        lean = (motion.position_mm(self.axis, time_s) - follows) / half_mm
        unit = 1e-6 if self._turns else 1e-3
        return error_motion(self.motion, unit * self.half_width * lean)


# A screw worn where it works most: play there, and none elsewhere.
_TURNOVER_MM = 0.2


@dataclass(frozen=True, slots=True)
class WornScrew(HiddenEffect):
    """Lost motion of width exp(−½ ((u − middle) / spread)²), u the share of travel."""

    name = "worn-screw"
    in_catalogue = False
    unstated = ("middle", "spread")
    axis: str
    width_um: float
    middle: float
    spread: float

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Random axis and position of the wear."""
        middle, spread = rng.uniform(0.3, 0.7), rng.uniform(0.08, 0.14)
        width_um = 6.0 * occasion.size_um
        return cls(occasion.axis(rng), width_um, float(middle), float(spread))

    def added_error_motions(self, motion: Motion, time_s: np.ndarray) -> Motions:
        half_mm = 0.5 * _TURNOVER_MM
        follows = motion.play_mm(self.axis, half_mm, time_s)
        side = (motion.position_mm(self.axis, time_s) - follows) / half_mm
        off = (motion.share(self.axis, time_s) - self.middle) / self.spread
        half = 0.5e-3 * self.width_um * np.exp(-0.5 * off**2)
        return error_motion(f"E{2 * self.axis}", -half * side)


# A ball screw that wobbles: its error repeats with every turn.
_LEADS_MM = (5.0, 6.0, 8.0, 10.0, 12.0, 16.0, 20.0, 25.0, 32.0, 40.0)


@dataclass(frozen=True, slots=True)
class ScrewCyclic(HiddenEffect):
    """amplitude sin(angle + phase) of the screw's angle, and a small harmonic."""

    name = "screw-cyclic"
    axis: str
    lead_mm: float
    amplitude_um: float
    phase_rad: float
    second_share: float = 0.0

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """One of the typical leads, and a second harmonic of at most a tenth."""
        return cls(
            occasion.axis(rng),
            float(rng.choice(_LEADS_MM)),
            occasion.size_um,
            float(rng.uniform(0.0, 2.0 * np.pi)),
            float(rng.uniform(0.0, 0.1)),
        )

    def added_error_motions(self, motion: Motion, time_s: np.ndarray) -> Motions:
        turned = motion.position_mm(self.axis, time_s) / self.lead_mm
        angle = 2.0 * np.pi * turned + self.phase_rad
        wave = np.sin(angle) + self.second_share * np.sin(2.0 * angle)
        return error_motion(f"E{self.axis}{self.axis}", 1e-3 * self.amplitude_um * wave)


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

    def added_error_motions(self, motion: Motion, time_s: np.ndarray) -> Motions:
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
        return cls(
            occasion.axis(rng),
            str(rng.choice(list("XYZ"))),
            occasion.size_um * float(rng.choice([-1.0, 1.0])),
            float(rng.uniform(5.0, 30.0)),
        )

    def added_error_motions(self, motion: Motion, time_s: np.ndarray) -> Motions:
        travel, sign = motion.since_reversal_mm(self.axis, time_s)
        left = 1e-3 * self.amplitude_um * sign * np.exp(-travel / self.decay_mm)
        return error_motion(f"E{self.direction}{self.axis}", left)


# A carriage that leans back while its axis speeds up, and forward while it brakes.
_TYPICAL_M_S2 = 1.5  # at which it has the requested size
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
        return cls(f"E{kind}{axis}", sign * occasion.size_um / _TYPICAL_M_S2 / arm_m)

    @property
    def keys(self) -> dict[str, str]:
        return {"axis": self.motion[2], "motion": self.motion}

    def added_error_motions(self, motion: Motion, time_s: np.ndarray) -> Motions:
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
        del motion
        angle = 2.0 * np.pi * self.frequency_hz * time_s + self.phase_rad
        return along(self.direction, 1e-3 * self.amplitude_um * np.sin(angle))


_REACH_MM = 120.0  # typical, from the axis to a target
_PERIODS_DEG = (4.0, 5.0, 6.0, 9.0, 12.0)


def _turn(motion: Motion, axis: str, off_rad: np.ndarray) -> Motions:
    """Reversed where the axis carries the workpiece."""
    carries_workpiece = axis in motion.machine.workpiece_side
    return error_motion(f"E{axis}{axis}", -off_rad if carries_workpiece else off_rad)


def _choose_rotary(rng: np.random.Generator, occasion: Occasion) -> str:
    return str(rng.choice([axis.name for axis in occasion.machine.rotary_axes]))


@dataclass(frozen=True, slots=True)
class TurningBacklash(HiddenEffect):
    """Play of a rotary axis."""

    name = "backlash"
    axis: str
    width_urad: float

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Random axis; half of the width to either side."""
        width = 2e3 * occasion.size_um / _REACH_MM
        return cls(_choose_rotary(rng, occasion), width)

    def added_error_motions(self, motion: Motion, time_s: np.ndarray) -> Motions:
        half_deg = float(np.degrees(0.5e-6 * self.width_urad))
        follows = motion.play_mm(self.axis, half_deg, time_s)
        off_deg = follows - motion.position_mm(self.axis, time_s)
        return _turn(motion, self.axis, np.radians(off_deg))


@dataclass(frozen=True, slots=True)
class GearCyclic(HiddenEffect):
    """amplitude sin(360° angle / period + phase) of a worm or ring scale."""

    name = "gear-cyclic"
    axis: str
    period_deg: float
    amplitude_urad: float
    phase_rad: float

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        return cls(
            _choose_rotary(rng, occasion),
            float(rng.choice(_PERIODS_DEG)),
            1e3 * occasion.size_um / _REACH_MM,
            float(rng.uniform(0.0, 2.0 * np.pi)),
        )

    def added_error_motions(self, motion: Motion, time_s: np.ndarray) -> Motions:
        turned = motion.position_mm(self.axis, time_s) / self.period_deg
        wave = np.sin(2.0 * np.pi * turned + self.phase_rad)
        return _turn(motion, self.axis, 1e-6 * self.amplitude_urad * wave)


@dataclass(frozen=True, slots=True)
class SwivelSag(HiddenEffect):
    """−amplitude 4u(1 − u) sin(angle + phase): a guide under a weight that swivels."""

    name = "swivel-sag"
    axis: str
    by: str
    direction: str
    amplitude_um: float
    phase_rad: float

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Random guide, swivel and direction; partly straightness and location."""
        return cls(
            occasion.axis(rng),
            _choose_rotary(rng, occasion),
            str(rng.choice(list("XYZ"))),
            2.0 * occasion.size_um,
            float(rng.uniform(0.0, 2.0 * np.pi)),
        )

    def added_error_motions(self, motion: Motion, time_s: np.ndarray) -> Motions:
        u = motion.share(self.axis, time_s)
        angle = np.radians(motion.position_mm(self.by, time_s)) + self.phase_rad
        sag = -1e-3 * self.amplitude_um * 4.0 * u * (1.0 - u) * np.sin(angle)
        return error_motion(f"E{self.direction}{self.axis}", sag)


@dataclass(frozen=True, slots=True)
class RotaryEccentricity(HiddenEffect):
    """amplitude (sin(angle + phase) − sin(phase)) of a ring scale off its axis."""

    name = "rotary-eccentricity"
    needs_model = True
    axis: str
    amplitude_urad: float
    phase_rad: float

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        amplitude = 1e3 * occasion.size_um / _REACH_MM
        phase = float(rng.uniform(0.0, 2.0 * np.pi))
        return cls(_choose_rotary(rng, occasion), amplitude, phase)

    def added_error_motions(self, motion: Motion, time_s: np.ndarray) -> Motions:
        angle = np.radians(motion.position_mm(self.axis, time_s)) + self.phase_rad
        wave = np.sin(angle) - np.sin(self.phase_rad)
        return _turn(motion, self.axis, 1e-6 * self.amplitude_urad * wave)
