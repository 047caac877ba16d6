"""A scale that warms towards a new temperature, and grows with it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from truepath.simulators.hidden.effect import HiddenEffect, Occasion, error_motion
from truepath.simulators.hidden.motion import Motion
from truepath.simulators.tracker_head import TrackerClock


@dataclass(frozen=True, slots=True)
class ThermalGrowth(HiddenEffect):
    """First-order warming from the begin of the recording; the sensor lags behind.

    rise_k : the temperature's change in the end; sensor_lag_s : of the sensor, which
        is told to the service where there is one
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
        """Draw how fast it warms; its far end moves by twice the size."""
        axis = occasion.axis(rng)
        tau_s = float(rng.uniform(0.3, 1.0) * occasion.duration_s)
        coefficient = float(rng.uniform(8.0, 12.0))
        reached = 1.0 - np.exp(-occasion.duration_s / tau_s)
        strain = 2.0 * occasion.size_um / (1e-3 * occasion.travel_mm(axis))
        rise_k = float(strain / (coefficient * reached) * rng.choice([-1.0, 1.0]))
        lag_s = float(rng.uniform(1.0, 6.0))
        return cls(axis, coefficient, rise_k, tau_s, lag_s, bool(rng.uniform() < 0.5))

    def parameters(self, clock: TrackerClock) -> dict[str, float]:
        """Return the coefficient, or growth and time constant without a sensor."""
        del clock
        if self.has_sensor:
            return {"coefficient_um_per_m_K": self.coefficient_um_per_m_k}
        return {
            "growth_um_per_m": self.coefficient_um_per_m_k * self.rise_k,
            "tau_s": self.tau_s,
        }

    def carry(self, motion: Motion, time_s: np.ndarray) -> dict[str, np.ndarray]:
        """Return the strain times the distance from the axis zero."""
        rise_k = -self.rise_k * np.expm1(-np.maximum(time_s, 0.0) / self.tau_s)
        axis = motion.machine.linear_axes[motion.column(self.axis)]
        reach_mm = motion.position_mm(self.axis, time_s) - axis.zero_mm
        strain = 1e-6 * self.coefficient_um_per_m_k * rise_k
        return error_motion(f"E{self.axis}{self.axis}", strain * reach_mm)

    def warming_degc(self, axis: str, time_s: np.ndarray) -> np.ndarray:
        """Return a first-order lag of a first-order rise."""
        if axis != self.axis:
            return np.zeros(len(time_s))
        t = np.maximum(time_s, 0.0)
        scale, sensor = self.tau_s, self.sensor_lag_s
        if abs(scale - sensor) < 1e-6 * scale:
            return self.rise_k * (1.0 - (1.0 + t / scale) * np.exp(-t / scale))
        slow, fast = scale * np.exp(-t / scale), sensor * np.exp(-t / sensor)
        return self.rise_k * (1.0 - (slow - fast) / (scale - sensor))
