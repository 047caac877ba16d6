"""Parts that warm: scales, spindle and column, cycles of coolant."""

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

    def added_error_motions(
        self, motion: Motion, time_s: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Strain times the distance from the axis zero."""
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
        """The cycle, mm."""
        del motion
        angle = 2.0 * np.pi / self.period_s * time_s + self.phase_rad
        wave = np.sin(angle + self.sharpness * np.sin(angle))
        return along(self.direction, 1e-3 * self.amplitude_um * wave)
