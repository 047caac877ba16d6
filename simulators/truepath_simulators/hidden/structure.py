"""Guides, frames, scales and spindles that bend, lean, twist or warm."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from truepath_simulators.hidden.effect import (
    HiddenEffect,
    Motions,
    Occasion,
    along,
    error_motion,
)
from truepath_simulators.hidden.motion import Motion
from truepath_simulators.machine.joints import rotation_matrices
from truepath_simulators.machine.tracker_head import TrackerClock
from truepath_simulators.machine.truth_machine import SQUARENESS
from truepath_simulators.machine_file import DIRECTIONS


# A guide that bends under the carriage that travels on it.
@dataclass(frozen=True, slots=True)
class ElasticSag(HiddenEffect):
    """−amplitude 4u(1 − u) v: largest in mid guide, in proportion to its load.

    u : share of the travel along `axis`, the guide; v : along `by`, whose carriage
        brings the load from one guide to the other
    """

    name = "elastic-sag"
    axis: str
    by: str
    direction: str
    amplitude_um: float

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Random guide, carriage and direction.

        The mean over v is straightness, the mean over u a tilt, so four times the size
        is needed for a motion of the size in addition to the rigid part.
        """
        axis = occasion.axis(rng)
        by = str(rng.choice([n for n in "XYZ" if n != axis]))
        amplitude = 4.0 * occasion.size_um * float(rng.choice([-1.0, 1.0]))
        return cls(axis, by, str(rng.choice(list("XYZ"))), amplitude)

    def added_error_motions(self, motion: Motion, time_s: np.ndarray) -> Motions:
        u, v = (motion.share(name, time_s) for name in (self.axis, self.by))
        deflection = -1e-3 * self.amplitude_um * 4.0 * u * (1.0 - u) * v
        return error_motion(f"E{self.direction}{self.axis}", deflection)


# A slide that floats up on its oil: the faster, the higher.
@dataclass(frozen=True, slots=True)
class FloatingSlide(HiddenEffect):
    """lift v² / (v² + usual²) across an axis, the same in both directions of v."""

    name = "floating-slide"
    in_catalogue = False
    unstated = ("usual_mm_s",)
    axis: str
    direction: str
    lift_um: float
    usual_mm_s: float

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        axis = occasion.axis(rng)
        direction = str(rng.choice([d for d in "XYZ" if d != axis]))
        return cls(axis, direction, 3.0 * occasion.size_um, 0.5 * occasion.feed_mm_s)

    def added_error_motions(self, motion: Motion, time_s: np.ndarray) -> Motions:
        square = motion.derivatives(self.axis, time_s)[0] ** 2
        lift = square / (square + self.usual_mm_s**2)
        return error_motion(f"E{self.direction}{self.axis}", 1e-3 * self.lift_um * lift)


# A column that leans as another carriage moves: a rotation of two axes at once.
_ARM_M = 0.25


@dataclass(frozen=True, slots=True)
class LeaningColumn(HiddenEffect):
    """An angle of one axis, amplitude sin(π u) cos(π v), v of the other axis.

    u, v : shares of both travels
    """

    name = "leaning-column"
    in_catalogue = False
    motion: str
    by: str
    amplitude_urad: float

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Two random axes and an angle; it acts over a quarter of a metre."""
        first, second, _ = rng.permutation(list("XYZ"))
        amplitude = 2.0 * occasion.size_um / _ARM_M
        return cls(f"E{rng.choice(list('ABC'))}{first}", str(second), amplitude)

    def added_error_motions(self, motion: Motion, time_s: np.ndarray) -> Motions:
        u, v = (motion.share(name, time_s) for name in (self.motion[2], self.by))
        lean = np.sin(np.pi * u) * np.cos(np.pi * v)
        return error_motion(self.motion, 1e-6 * self.amplitude_urad * lean)


# A guide whose straightness waves with the pitch of its screws or rollers.
@dataclass(frozen=True, slots=True)
class WavyGuide(HiddenEffect):
    """A rail pulled down by bolts of one pitch: the carriage follows its waves."""

    name = "wavy-guide"
    in_catalogue = False
    axis: str
    direction: str
    pitch_mm: float
    amplitude_um: float
    phase_rad: float = 0.0

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        axis = occasion.axis(rng)
        return cls(
            axis,
            str(rng.choice([d for d in "XYZ" if d != axis])),
            float(rng.uniform(8.0, 40.0)),
            occasion.size_um,
            float(rng.uniform(0.0, 2.0 * np.pi)),
        )

    def parameters(self, clock: TrackerClock) -> dict[str, float]:
        del clock
        return {"period_mm": self.pitch_mm, "amplitude_um": self.amplitude_um}

    def added_error_motions(self, motion: Motion, time_s: np.ndarray) -> Motions:
        run = motion.position_mm(self.axis, time_s) / self.pitch_mm
        wave = np.sin(2.0 * np.pi * run + self.phase_rad)
        return error_motion(
            f"E{self.direction}{self.axis}", 1e-3 * self.amplitude_um * wave
        )


# A frame that twists with two axes at once, in a shape outside of the catalogue.
@dataclass(frozen=True, slots=True)
class Twist(HiddenEffect):
    """amplitude sin(π waves u) sin(π waves v), u and v the shares of the travels."""

    name = "twist"
    in_catalogue = False
    first: str
    second: str
    direction: str
    amplitude_um: float
    waves: tuple[float, float] = (2.0, 2.0)

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Two random axes, each with about one wave up and one down."""
        first, second, _ = rng.permutation(list("XYZ"))
        waves = (float(rng.uniform(1.8, 2.2)), float(rng.uniform(1.8, 2.2)))
        direction = str(rng.choice(list("XYZ")))
        return cls(str(first), str(second), direction, 2.0 * occasion.size_um, waves)

    @property
    def keys(self) -> dict[str, str]:
        return {"plane": self.first + self.second, "direction": self.direction}

    def added_error_motions(self, motion: Motion, time_s: np.ndarray) -> Motions:
        bulge = np.ones(len(time_s))
        for name, waves in zip((self.first, self.second), self.waves, strict=True):
            bulge *= np.sin(np.pi * waves * motion.share(name, time_s))
        return error_motion(
            f"E{self.direction}{self.first}", 1e-3 * self.amplitude_um * bulge
        )


# Two axes that went out of square after the model in use: by a crash, a move.
@dataclass(frozen=True, slots=True)
class Squareness(HiddenEffect):
    """The direction of travel of an axis is turned, as in the truth machine."""

    name = "squareness"
    needs_model: ClassVar[bool] = True
    symbol: str
    value_urad: float

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Random pair of axes; over its travel one leans by twice the size.

        The tracker's pose absorbs the mean.
        """
        symbol = str(rng.choice(list(SQUARENESS)))
        travel_m = 1e-3 * occasion.travel_mm(SQUARENESS[symbol][0])
        sign = float(rng.choice([-1.0, 1.0]))
        return cls(symbol, sign * 2.0 * occasion.size_um / travel_m)

    def added_error_motions(self, motion: Motion, time_s: np.ndarray) -> Motions:
        """Shift s (R d − d) for the position s on the direction d of travel."""
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


# A scale that warms towards a new temperature, and grows with it.
@dataclass(frozen=True, slots=True)
class ThermalGrowth(HiddenEffect):
    """First-order warming from the begin of the recording; the sensor lags behind.

    rise_k : final change of the temperature; sensor_lag_s : of the sensor, which the
        service reads where there is one
    """

    name = "thermal-growth"
    axis: str
    coefficient_um_per_m_k: float
    rise_k: float
    tau_s: float
    sensor_lag_s: float = 5.0
    has_sensor: bool = True

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Random time constant; the far end moves by twice the size."""
        axis = occasion.axis(rng)
        tau_s = float(rng.uniform(0.3, 1.0) * occasion.duration_s)
        coefficient = float(rng.uniform(8.0, 12.0))
        reached = 1.0 - np.exp(-occasion.duration_s / tau_s)
        strain = 2.0 * occasion.size_um / (1e-3 * occasion.travel_mm(axis))
        rise_k = float(strain / (coefficient * reached) * rng.choice([-1.0, 1.0]))
        lag_s = float(rng.uniform(1.0, 6.0))
        return cls(axis, coefficient, rise_k, tau_s, lag_s, bool(rng.uniform() < 0.5))

    def parameters(self, clock: TrackerClock) -> dict[str, float]:
        """The coefficient, or growth and time constant without a sensor."""
        del clock
        if self.has_sensor:
            return {"coefficient_um_per_m_K": self.coefficient_um_per_m_k}
        return {
            "growth_um_per_m": self.coefficient_um_per_m_k * self.rise_k,
            "tau_s": self.tau_s,
        }

    def added_error_motions(self, motion: Motion, time_s: np.ndarray) -> Motions:
        rise_k = -self.rise_k * np.expm1(-np.maximum(time_s, 0.0) / self.tau_s)
        axis = motion.machine.linear_axes[motion.column(self.axis)]
        reach_mm = motion.position_mm(self.axis, time_s) - axis.zero_mm
        strain = 1e-6 * self.coefficient_um_per_m_k * rise_k
        return error_motion(f"E{self.axis}{self.axis}", strain * reach_mm)

    def warming_degc(self, axis: str, time_s: np.ndarray) -> np.ndarray:
        """A first-order lag of a first-order rise."""
        if axis != self.axis:
            return np.zeros(len(time_s))
        t = np.maximum(time_s, 0.0)
        scale, sensor = self.tau_s, self.sensor_lag_s
        if abs(scale - sensor) < 1e-6 * scale:
            return self.rise_k * (1.0 - (1.0 + t / scale) * np.exp(-t / scale))
        slow, fast = scale * np.exp(-t / scale), sensor * np.exp(-t / sensor)
        return self.rise_k * (1.0 - (slow - fast) / (scale - sensor))


# A spindle or a column that warms and carries the tool along.
@dataclass(frozen=True, slots=True)
class SpindleGrowth(HiddenEffect):
    """A first-order rise along the spindle from the begin of the recording."""

    name = "spindle-growth"
    growth_um: float
    tau_s: float

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Random time constant; from begin to end the tool moves by twice the size."""
        tau_s = float(rng.uniform(0.1, 0.8) * occasion.duration_s)
        reached = 1.0 - np.exp(-occasion.duration_s / tau_s)
        sign = float(rng.choice([-1.0, 1.0]))
        return cls(float(2.0 * sign * occasion.size_um / reached), tau_s)

    def common_shift_mm(self, motion: Motion, time_s: np.ndarray) -> np.ndarray:
        """Motion of the tool along Z; a swivelling head is not considered."""
        del motion
        rise = -np.expm1(-np.maximum(time_s, 0.0) / self.tau_s)
        return along("Z", 1e-3 * self.growth_um * rise)


# Coolant or air conditioning that switches on and off: slow, and in no catalogue.
@dataclass(frozen=True, slots=True)
class CoolantCycle(HiddenEffect):
    """A steady cycle in time, slower than a vibration, in one direction.

    sharpness : 0 for a sine; above it warming and cooling have a corner
    """

    name = "coolant-cycle"
    in_catalogue = False
    direction: str
    period_s: float
    amplitude_um: float
    phase_rad: float = 0.0
    sharpness: float = 0.0

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Random period that occurs at least four times."""
        longest = min(60.0, occasion.duration_s / 4.0)
        return cls(
            str(rng.choice(list("XYZ"))),
            float(rng.uniform(8.0, longest)),
            occasion.size_um,
            float(rng.uniform(0.0, 2.0 * np.pi)),
            float(rng.uniform(0.0, 0.3)),
        )

    def parameters(self, clock: TrackerClock) -> dict[str, float]:
        """Period, on the tracker's clock, and amplitude."""
        period_s = self.period_s * (1.0 + clock.drift)
        return {"period_s": period_s, "amplitude_um": self.amplitude_um}

    def common_shift_mm(self, motion: Motion, time_s: np.ndarray) -> np.ndarray:
        del motion
        angle = 2.0 * np.pi / self.period_s * time_s + self.phase_rad
        wave = np.sin(angle + self.sharpness * np.sin(angle))
        return along(self.direction, 1e-3 * self.amplitude_um * wave)
