"""An axis that grows as it warms: by its sensor, or by time where there is none."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from truepath.kinematics.conditions import Conditions
from truepath.kinematics.effects.base import Effect, columns_along
from truepath.kinematics.effects.error_motion import find_arm, reference_position_mm
from truepath.kinematics.effects.family import (
    Candidate,
    CandidateEstimate,
    Family,
    Quantity,
    Scan,
    read_words,
)
from truepath.kinematics.effects.keys import AXIS
from truepath.kinematics.machine.machine import LinearAxis, Machine

_USUAL_PER_K = 1e-5  # steel: 11 µm/m/K; glass scales: 8; a scale that follows it: 0
_USUAL_GROWTH = 2e-5
_FEWEST_KELVIN = 0.05
_TAUS = 24
_START = "start_degC"


@dataclass(frozen=True)
class ThermalGrowth(Effect):
    """Strain of the axis' scale by the change of its own sensor, about its zero."""

    kind = "thermal-growth"
    units = {"": "1/K"}
    axis: LinearAxis
    start_degc: float

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 1"]:
        """Direction of the axis times distance from its zero times the change, K."""
        celsius = _read_sensor(self.axis, at)
        if celsius is None:
            return np.zeros((len(at), 3, 1))
        return _strain(self.axis, at, celsius - self.start_degc)


@dataclass(frozen=True)
class WarmingUp(Effect):
    """Strain that approaches its final value, θ, exponentially from the start."""

    kind = "warming-up"
    units = {"": "1"}
    axis: LinearAxis
    tau_s: float
    start_s: float

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 1"]:
        """Direction of the axis times distance from its zero times the rise."""
        rise = -np.expm1(-(at.time_s - self.start_s) / self.tau_s)
        return _strain(self.axis, at, rise)


def list_time_constants(at: Conditions) -> Float64[np.ndarray, " v"]:
    """Time constants in s that a recording can distinguish."""
    span_s = max(float(np.ptp(at.time_s)), 1.0)
    return np.geomspace(0.03 * span_s, 5.0 * span_s, _TAUS)


def _strain(
    axis: LinearAxis, at: Conditions, by: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, "n 3 1"]:
    reach = at.axis_mm(axis.name) - reference_position_mm(axis)
    arm = find_arm(f"E{axis.name}{axis.name}", at)
    return columns_along(arm, reach * by)


def _read_sensor(axis: LinearAxis, at: Conditions) -> Float64[np.ndarray, " n"] | None:
    recorded = at.recorded
    if recorded is None or recorded.temperature_degc is None:
        return None
    if axis.name not in recorded.sensors:
        return None
    return recorded.temperature_degc[:, recorded.sensors.index(axis.name)]


class ThermalGrowthFamily(Family):
    """One candidate per linear axis: by its sensor if that changed, else by time."""

    name = "thermal-growth"
    varies_with = "time"
    value_name = "tau_s"
    effect = ThermalGrowth
    keys = {"axis": AXIS}
    words = read_words("""
        [en]
        title = Thermal growth
        cause = Scale or screw of an axis warms during the measurement: by its own work,
            by coolant, by the hall.
        looks_like = The positioning of one axis stretches from line to line, most at
            its far end, following its temperature.
        remedy = Warm the machine up before measuring; enter the coefficient in the
            controller's temperature compensation; fit a scale sensor.
        [de]
        title = Wärmedehnung
        cause = Maßstab oder Spindel einer Achse erwärmt sich während der Messung: durch
            eigene Arbeit, Kühlmittel oder die Halle.
        looks_like = Die Positionierung einer Achse dehnt sich von Gerade zu Gerade, am
            meisten am fernen Ende, und folgt ihrer Temperatur.
        remedy = Die Maschine vor dem Messen warmfahren; den Koeffizienten in die
            Temperaturkompensation der Steuerung eintragen; einen Fühler am Maßstab
            anbringen.
        """)

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        """One per linear axis."""
        return [self._candidate(axis, at) for axis in at.machine.linear_axes]

    def _candidate(self, axis: LinearAxis, at: Conditions) -> Candidate:
        celsius = _read_sensor(axis, at)
        if celsius is not None and np.ptp(celsius) > _FEWEST_KELVIN:
            first = float(celsius[np.argmin(at.time_s)])
            return self.make_candidate(ThermalGrowth(axis, first), [_USUAL_PER_K])
        half_s = 0.5 * float(np.ptp(at.time_s))
        effect = WarmingUp(axis, half_s, float(at.time_s.min()))
        return self.make_candidate(effect, [_USUAL_GROWTH])

    def scan(self, candidate: Candidate, at: Conditions) -> Scan | None:
        """Time constants in s; None where there is a sensor."""
        if candidate.value is None:
            return None
        return Scan(self.value_name, list_time_constants(at))

    def list_numbers(self, candidate: Candidate) -> dict[str, float]:
        """Temperature at which there is no growth, or the time constant."""
        if isinstance(candidate.effect, ThermalGrowth):
            return {_START: candidate.effect.start_degc}
        return {self.value_name: candidate.value or 0.0}

    def restore(
        self, machine: Machine, keys: Mapping[str, str], numbers: Mapping[str, float]
    ) -> Effect | None:
        """Growth by the sensor; None by time, which ends with its Run."""
        if _START not in numbers:
            return None
        return ThermalGrowth(machine.linear(keys["axis"]), numbers[_START])

    def state(self, found: CandidateEstimate) -> dict[str, Quantity]:
        """Coefficient in µm/(m K), or growth in µm/m and time constant in s."""
        strain = found.parameters[0].scale(1e6)
        if found.candidate.value is None:
            return {"coefficient_um_per_m_K": strain}
        return {"growth_um_per_m": strain, "tau_s": found.value}
