"""An axis, or the tool, that grows as it warms: by its sensor, or else by time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from truepath.kinematics.conditions import Conditions
from truepath.kinematics.effects.base import Effect, columns_along
from truepath.kinematics.effects.error_motion import compute_arm, reference_position_mm
from truepath.kinematics.effects.family import (
    USUAL_MM,
    Candidate,
    CandidateEstimate,
    Family,
    Quantity,
    Scan,
    read_words,
)
from truepath.kinematics.effects.keys import AXIS
from truepath.kinematics.machine.machine import LinearAxis, Machine

_TYPICAL_PER_K = 1e-5  # steel: 11 µm/m/K; glass scales: 8; a scale that follows it: 0
_TYPICAL_GROWTH = 2e-5
_FEWEST_KELVIN = 0.05
_START = "start_degC"


@dataclass(frozen=True)
class ThermalGrowth(Effect):
    """Strain of the axis' scale by the change of its own sensor, about its zero."""

    kind = "thermal-growth"
    units = {"": "1/K"}
    axis: LinearAxis
    start_degc: float

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 1"]:
        celsius = at.sensor_degc(self.axis.name)
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
        rise = -np.expm1(-(at.time_s - self.start_s) / self.tau_s)
        return _strain(self.axis, at, rise)


def _scan_time_constants(at: Conditions) -> Scan:
    span_s = max(float(np.ptp(at.time_s)), 1.0)
    return Scan("tau_s", np.geomspace(0.03 * span_s, 5.0 * span_s, 24))


def _strain(
    axis: LinearAxis, at: Conditions, by: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, "n 3 1"]:
    reach = at.axis_mm(axis.name) - reference_position_mm(axis)
    arm = compute_arm(f"E{axis.name}{axis.name}", at)
    return columns_along(arm, reach * by)


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
        return [self._candidate(axis, at) for axis in at.machine.linear_axes]

    def _candidate(self, axis: LinearAxis, at: Conditions) -> Candidate:
        celsius = at.sensor_degc(axis.name)
        if celsius is not None and np.ptp(celsius) > _FEWEST_KELVIN:
            first = float(celsius[np.argmin(at.time_s)])
            return self.make_candidate(ThermalGrowth(axis, first), [_TYPICAL_PER_K])
        half_s = 0.5 * float(np.ptp(at.time_s))
        effect = WarmingUp(axis, half_s, float(at.time_s.min()))
        return self.make_candidate(effect, [_TYPICAL_GROWTH])

    def scan(self, candidate: Candidate, at: Conditions) -> Scan | None:
        return None if candidate.value is None else _scan_time_constants(at)

    def list_numbers(self, candidate: Candidate) -> dict[str, float]:
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
        strain = found.parameters[0].scale(1e6)
        if found.candidate.value is None:
            return {"coefficient_um_per_m_K": strain}
        return {"growth_um_per_m": strain, "tau_s": found.value}


@dataclass(frozen=True)
class ToolGrowth(Effect):
    """A shift of the tool along itself; it approaches its end, θ, exponentially."""

    kind = "tool-growth"
    units = {"": "mm"}
    tau_s: float
    start_s: float

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 1"]:
        """Direction of the tool times the rise; 0 where no tool is measured."""
        rise = -np.expm1(-(at.time_s - self.start_s) / self.tau_s)
        along = at.chain.tool_frame[:, :, 2]  # the tool's own Z is the spindle, ISO 841
        return (along * rise[:, None])[:, :, None]


class ToolGrowthFamily(Family):
    """One candidate, its time constant scanned."""

    name = "spindle-growth"
    effect = ToolGrowth
    ends_with_run = True
    varies_with = "time"
    value_name = "tau_s"
    words = read_words("""
        [en]
        title = Growth of spindle or column
        cause = Spindle, head or column warms or cools during the measurement: after a
            start, by its own work, by the hall.
        looks_like = All lines shift along the tool, fast at first and then slower,
            whatever axis moves.
        remedy = Warm the spindle up before measuring and before work; enter its growth
            in the controller's temperature compensation.
        [de]
        title = Dehnung von Spindel oder Ständer
        cause = Spindel, Kopf oder Ständer erwärmt sich oder kühlt während der Messung
            ab: nach dem Einschalten, durch eigene Arbeit oder die Halle.
        looks_like = Alle Geraden verschieben sich entlang des Werkzeugs, erst schnell
            und dann langsamer, gleich welche Achse fährt.
        remedy = Die Spindel vor dem Messen und vor der Arbeit warmlaufen lassen; ihre
            Dehnung in die Temperaturkompensation der Steuerung eintragen.
        """)

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        half_s = 0.5 * max(float(np.ptp(at.time_s)), 1.0)
        effect = ToolGrowth(half_s, float(at.time_s.min()))
        return [self.make_candidate(effect, [2.0 * USUAL_MM])]

    def scan(self, candidate: Candidate, at: Conditions) -> Scan:
        return _scan_time_constants(at)

    def state(self, found: CandidateEstimate) -> dict[str, Quantity]:
        growth = found.parameters[0].scale(1e3)
        return {"growth_um": growth, "tau_s": found.value}
