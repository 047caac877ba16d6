"""An axis that grows as it warms: by its sensor, or by time where there is none."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from app.kinematics.conditions import Conditions
from app.kinematics.effects.base import Effect, Parameter
from app.kinematics.effects.catalogue import (
    Candidate,
    Family,
    Measured,
    Scan,
    Signature,
)
from app.kinematics.effects.error_motion import arm_of, reference_position_mm
from app.kinematics.machine import LinearAxis, Machine

_USUAL_PER_K = 1e-5  # steel: 11 µm/m/K; glass scales: 8; a scale that follows it: 0
_USUAL_GROWTH = 2e-5
_FEWEST_KELVIN = 0.05
_TAUS = 24
_START = "start_degC"


@dataclass(frozen=True)
class ThermalGrowth(Effect):
    """Strain of the axis' scale by the change of its own sensor, about its zero."""

    axis: LinearAxis
    start_degc: float

    @property
    def name(self) -> str:
        """Name in the provenance of an estimate."""
        return f"thermal-growth-{self.axis.name}"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The coefficient, in 1/K."""
        return (Parameter(self.name, "1/K"),)

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 1"]:
        """Return the axis' direction times distance from its zero times the change."""
        recorded = at.recorded
        name = self.axis.name
        if recorded is None or recorded.temperature_degc is None:
            return np.zeros((len(at), 3, 1))
        if name not in recorded.sensors:
            return np.zeros((len(at), 3, 1))
        celsius = recorded.temperature_degc[:, recorded.sensors.index(name)]
        return _strained(self.axis, at, celsius - self.start_degc)


@dataclass(frozen=True)
class WarmingUp(Effect):
    """Strain that approaches its end exponentially from the start of the recording."""

    axis: LinearAxis
    tau_s: float
    start_s: float

    @property
    def name(self) -> str:
        """Name in the provenance of an estimate."""
        return f"warming-up-{self.axis.name}-{self.tau_s:.4g}"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The final strain."""
        return (Parameter(self.name, "1"),)

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 1"]:
        """Return the axis' direction times distance from its zero times the rise."""
        rise = -np.expm1(-(at.time_s - self.start_s) / self.tau_s)
        return _strained(self.axis, at, rise)


def _strained(
    axis: LinearAxis, at: Conditions, by: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, "n 3 1"]:
    reach = at.axis_mm(axis.name) - reference_position_mm(axis)
    return (arm_of(f"E{axis.name}{axis.name}", at) * (reach * by)[:, None])[:, :, None]


class ThermalGrowthFamily(Family):
    """Every straight axis: by its sensor where that has seen a change, else by time."""

    name = "thermal-growth"
    scanned = "tau_s"
    signature = Signature(
        cause="Scale or screw of an axis warms during the measurement: by its own "
        "work, by coolant, by the hall.",
        looks_like="The positioning of one axis stretches from line to line, most at "
        "its far end, following its temperature.",
        remedy="Warm the machine up before measuring; enter the coefficient in the "
        "controller's temperature compensation; fit a scale sensor.",
    )

    def candidates(self, at: Conditions) -> Sequence[Candidate]:
        """Return one an axis."""
        return [self._candidate(axis, at) for axis in at.machine.linear_axes]

    def _candidate(self, axis: LinearAxis, at: Conditions) -> Candidate:
        recorded, keys = at.recorded, {"axis": axis.name}
        if (
            recorded is not None
            and recorded.temperature_degc is not None
            and axis.name in recorded.sensors
        ):
            celsius = recorded.temperature_degc[:, recorded.sensors.index(axis.name)]
            if np.ptp(celsius) > _FEWEST_KELVIN:
                first = float(celsius[np.argmin(at.time_s)])
                effect = ThermalGrowth(axis, first)
                return Candidate(self.name, keys, effect, np.array([_USUAL_PER_K]))
        span = float(np.ptp(at.time_s))
        effect = WarmingUp(axis, 0.5 * span, float(at.time_s.min()))
        usual = np.array([_USUAL_GROWTH])
        return Candidate(self.name, keys, effect, usual, 0.5 * span)

    def scan(self, candidate: Candidate, at: Conditions) -> Scan | None:
        """Return time constants, where there is no sensor."""
        if candidate.value is None:
            return None
        span = float(np.ptp(at.time_s))
        return Scan("tau_s", np.geomspace(0.03 * span, 5.0 * span, _TAUS))

    def at_value(self, candidate: Candidate, at: Conditions, value: float) -> Candidate:
        """Return the candidate of another time constant."""
        axis = at.machine.linear(candidate.keys["axis"])
        effect = WarmingUp(axis, value, float(at.time_s.min()))
        return replace(candidate, effect=effect, value=value)

    def kept(self, candidate: Candidate) -> dict[str, float]:
        """Return the temperature at which there is no growth, or the time constant."""
        if isinstance(candidate.effect, ThermalGrowth):
            return {_START: candidate.effect.start_degc}
        return super().kept(candidate)

    def restored(
        self, machine: Machine, keys: Mapping[str, str], numbers: Mapping[str, float]
    ) -> Effect | None:
        """Return growth by the sensor; what warms up with time ends with its Run."""
        if _START not in numbers:
            return None
        return ThermalGrowth(machine.linear(keys["axis"]), numbers[_START])

    def parameters(
        self,
        candidate: Candidate,
        theta: Float64[np.ndarray, "1"],
        covariance: Float64[np.ndarray, "1 1"],
        value_sigma: float,
    ) -> dict[str, Measured]:
        """Return the coefficient, or growth and time constant."""
        sigma = float(np.sqrt(covariance[0, 0]))
        strain = Measured(float(theta[0]) * 1e6, sigma * 1e6)
        if candidate.value is None:
            return {"coefficient_um_per_m_K": strain}
        return {
            "growth_um_per_m": strain,
            "tau_s": Measured(candidate.value, value_sigma),
        }
