"""One gate for what sensors show: of drivers, bundles and imports alike.

A reading is believed if it may be one by itself, and follows from the one before. A
channel that has failed stays out until it has been steady for a while.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from statistics import median

import numpy as np
from numpy.typing import NDArray

from truepath.app.files.environment import DEGC, HUMIDITY, PRESSURE
from truepath.app.files.run import IMPLAUSIBLE, RunEvent
from truepath.drivers.interfaces.thermometers import Channel

STEADY_S = 10.0
# The most between two readings: so much at once, so much a second.
_STEP = {"degC": (2.0, 0.5), "hPa": (3.0, 0.5), "percent": (15.0, 3.0)}
_LONGEST_S = 30.0  # that a change may have gone on for, from one reading to the next
_JUMP = 1e3  # of magnitude, as of random bits in the place of an exponent
_APART_K, _ALIKE_K = 20.0, 5.0  # of a scale from all others, which agree
_WEATHER_HPA, _LOW_SITE_HPA = 50.0, 800.0  # any number of mmHg is below this
_UNSTEADY = "it is not steady yet"


@dataclass(slots=True)
class ChannelGate:
    """Judges the readings of one channel in the order of time.

    altitude_m : of the site; None where it is not stated
    beside : gates of sensors that a scale cannot differ from by much
    why : the first cause of all that was left out
    """

    channel: Channel
    altitude_m: float | None = None
    beside: list[ChannelGate] = field(default_factory=list)
    seen: int = 0
    left_out: int = 0
    why: str = ""
    believed: float | None = None
    _last: float = math.nan  # that may be a reading, believed or not
    _last_s: float = -math.inf
    _out: tuple[float, int] | None = None  # since when, and steady readings since

    def __post_init__(self) -> None:
        """Narrow the pressures to those of the site, where the channel states none."""
        if self.channel.unit == "hPa" and math.isnan(self.channel.low):
            low, high = find_pressures(self.altitude_m)
            self.channel = replace(self.channel, low=low, high=high)

    def judge(self, at_s: float, value: float) -> str:
        """Return why a number is not believed, empty where it is."""
        self.seen += 1
        fault = self._find_fault(at_s, value)
        if fault:
            self._out, self.why = (at_s, 0), self.why or fault
        elif self._out is not None:
            since_s, count = self._out
            is_steady = count > 0 and at_s - since_s >= STEADY_S
            self._out = None if is_steady else (since_s, count + 1)
            fault = "" if is_steady else _UNSTEADY
        self.left_out += bool(fault)
        self.believed = None if fault else value
        return fault

    def describe(self, name: str) -> str:
        """Return how much was left out, and why."""
        return f"{name}: {self.left_out} of {self.seen} readings not used: {self.why}"

    def _find_fault(self, at_s: float, value: float) -> str:
        unit, last = self.channel.unit, self._last
        if fault := self.channel.find_fault(value):
            return fault + (self._describe_site() if unit == "hPa" else "")
        at_once, a_second = _STEP[unit]
        if value == 0.0 and not abs(last) <= at_once:
            return f"0 {unit} to the last digit, as of a register that nothing writes"
        step_s = min(at_s - self._last_s, _LONGEST_S)
        self._last, self._last_s = value, at_s
        small, large = min(abs(value), abs(last)), max(abs(value), abs(last))
        is_jump = large > max(1.0, _JUMP * small)
        if is_jump or abs(value - last) > at_once + a_second * step_s:
            return f"{value:g} {unit} comes {step_s:.3g} s after {last:g} {unit}"
        others = [one.believed for one in self.beside if one.believed is not None]
        if len(others) > 1 and max(others) - min(others) < _ALIKE_K:
            apart_k = value - median(others)
            if abs(apart_k) > _APART_K:
                return f"{value:g} {unit} is {apart_k:+.0f} K from all others"
        return ""

    def _describe_site(self) -> str:
        if self.altitude_m is None:
            return ", of a site whose altitude is not stated"
        return f", of a site at {self.altitude_m:g} m"


def find_pressures(altitude_m: float | None) -> tuple[float, float]:
    """Return the lowest and highest pressure of a site, hPa.

    Where nobody states its altitude it is no high one: its pressure could be in mmHg.
    """
    if altitude_m is None:
        return _LOW_SITE_HPA, math.nan
    usual_hpa = 1013.25 * (1.0 - 2.25577e-5 * altitude_m) ** 5.25588
    return usual_hpa - _WEATHER_HPA, usual_hpa + _WEATHER_HPA


def make_gates(
    channels: Mapping[str, Channel], altitude_m: float | None = None
) -> dict[str, ChannelGate]:
    """Return the gate of each channel of a group."""
    gates = {name: ChannelGate(one, altitude_m) for name, one in channels.items()}
    scales = {name for name in gates if len(name) == len("X" + DEGC)}
    for name in scales:
        others = (scales | {"air" + DEGC}) & {*gates} - {name}
        gates[name].beside += [gates[other] for other in sorted(others)]
    return gates


def gate_columns(
    time_s: NDArray[np.float64],
    columns: Mapping[str, NDArray[np.float64]],
    altitude_m: float | None,
) -> tuple[dict[str, NDArray[np.float64]], tuple[RunEvent, ...]]:
    """Return columns with NaN for what is not believed, and an event for each such.

    What a channel showed just before its first failure goes as well.
    """
    kinds = ("air" + DEGC, PRESSURE, HUMIDITY)
    channels = {n: Channel(n if n in kinds else "a" + DEGC) for n in columns}
    gates = make_gates(channels, altitude_m)
    kept = {name: values.copy() for name, values in columns.items()}
    for row, at_s in enumerate(time_s.tolist()):
        for name, gate in gates.items():
            value, was_well = float(kept[name][row]), not gate.why
            if math.isnan(value) or not gate.judge(at_s, value):
                continue
            is_early = was_well and at_s - time_s[0] < STEADY_S
            gate.left_out += row if is_early else 0
            kept[name][0 if is_early else row : row + 1] = np.nan
    told = [gate.describe(name) for name, gate in gates.items() if gate.left_out]
    return kept, tuple(RunEvent(0, IMPLAUSIBLE, text) for text in told)
