"""One plausibility check for sensors: of drivers, bundles and imports alike.

A reading is accepted if it is plausible by itself, and follows from the one before. A
channel that has failed stays rejected until it has been steady for a while.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from statistics import median

import numpy as np
from numpy.typing import NDArray

from truepath.files.bundle.run import IMPLAUSIBLE, RunEvent
from truepath.files.environment import DEGC, HUMIDITY, PRESSURE
from truepath.numerics.air_index import compute_site_pressure_hpa
from truepath_drivers.interfaces.thermometers import Channel

STEADY_S = 10.0
# The most between two readings: so much at once, so much a second.
_STEP = {"degC": (2.0, 0.5), "hPa": (3.0, 0.5), "percent": (15.0, 3.0)}
_DRIFT = 0.04  # of it may continue for long
_LONGEST_S = 30.0  # that a change may have gone on for, from one reading to the next
_JUMP = 1e3  # of magnitude, as of random bits in the place of an exponent
_APART_K, _ALIKE_K = 20.0, 5.0  # of a scale from all others, which agree
_PLAIN_DEGC = 15.0, 35.0  # all in here agree
_WEATHER_HPA, _LOW_SITE_HPA = 50.0, 800.0  # any number of mmHg is below this
_SCALE, _NEAR = re.compile("[A-Z]_degC"), re.compile("([A-Z]|air)_degC")


@dataclass(slots=True)
class ChannelGate:
    """Checks the readings of one channel in the order of time.

    altitude_m : of the site; None where it is not stated
    group : gates by name, to which this one is added; a scale agrees with others
    why : the first cause of all that was rejected
    """

    name: str
    channel: Channel
    altitude_m: float | None = None
    group: dict[str, ChannelGate] = field(default_factory=dict)
    seen: int = 0
    left_out: int = 0
    why: str = ""
    believed: float | None = None
    is_near: bool = False  # to scales
    _last: float = math.nan  # that may be a reading, believed or not
    _last_s: float = -math.inf
    _good: float = math.nan  # the last one of those believed for a while
    _good_s: float = -math.inf
    _begun_s: float = math.inf
    _out: tuple[float, int] | None = None  # since when, and steady readings since

    def __post_init__(self) -> None:
        self.group[self.name] = self
        self.is_near = bool(_NEAR.fullmatch(self.name))
        if self.channel.unit == "hPa" and math.isnan(self.channel.low):
            low, high = find_pressures(self.altitude_m)
            self.channel = replace(self.channel, low=low, high=high)

    def check(self, at_s: float, value: float) -> str:
        """Why a number is rejected, empty where it is accepted."""
        self.seen += 1
        fault = self._find_fault(at_s, value)
        if fault:
            self._out, self.why = (at_s, 0), self.why or fault
        elif self._out is not None:
            since_s, count = self._out
            is_steady = count > 0 and at_s - since_s >= STEADY_S
            at_once, a_second = _STEP[self.channel.unit]
            drift = _DRIFT * a_second * (at_s - self._good_s)
            is_steady &= not abs(value - self._good) > at_once + drift
            self._out = None if is_steady else (since_s, count + 1)
            fault = "" if is_steady else "it is not steady yet"
        self.left_out += bool(fault)
        self.believed = None if fault else value
        self._begun_s = min(self._begun_s, at_s)
        if not fault and at_s - self._begun_s >= STEADY_S:
            self._good, self._good_s = value, at_s
        return fault

    def describe(self) -> str:
        """Number of rejected readings, and why."""
        count = f"{self.left_out} of {self.seen} readings"
        return f"{self.name}: {count} not used: {self.why}"

    def _find_fault(self, at_s: float, value: float) -> str:
        unit, last = self.channel.unit, self._last
        if fault := self.channel.find_fault(value):
            site = "whose altitude is not stated"
            if self.altitude_m is not None:
                site = f"at {self.altitude_m:g} m"
            return f"{fault}, of a site {site}" if unit == "hPa" else fault
        at_once, a_second = _STEP[unit]
        if value == 0.0 and not abs(last) <= at_once:
            return f"0 {unit} to the last digit, as of a register that nothing writes"
        step_s = min(at_s - self._last_s, _LONGEST_S)
        self._last, self._last_s = value, at_s
        small, large = sorted((abs(value), abs(last)))
        is_jump = large > max(1.0, _JUMP * small)
        if is_jump or abs(value - last) > at_once + a_second * step_s:
            return f"{value:g} {unit} comes {step_s:.3g} s after {last:g} {unit}"
        near = self.group.values() if _SCALE.fullmatch(self.name) else ()
        others = [o.believed for o in near if o is not self and o.is_near]
        others = [one for one in others if one is not None]
        if len(others) < 2:
            return ""
        apart_k = value - median(others)
        if abs(apart_k) < _APART_K or max(others) - min(others) > _ALIKE_K:
            return ""
        return f"{value:g} {unit} is {apart_k:+.0f} K from all others"


def find_pressures(altitude_m: float | None) -> tuple[float, float]:
    """Lowest and highest pressure of a site, hPa; NaN: no limit.

    A site without a stated altitude is assumed low: its pressure could be in mmHg.
    """
    if altitude_m is None:
        return _LOW_SITE_HPA, math.nan
    usual_hpa = compute_site_pressure_hpa(altitude_m)
    return usual_hpa - _WEATHER_HPA, usual_hpa + _WEATHER_HPA


def gate_columns(
    time_s: NDArray[np.float64],
    columns: Mapping[str, NDArray[np.float64]],
    altitude_m: float | None,
) -> tuple[dict[str, NDArray[np.float64]], tuple[RunEvent, ...]]:
    """Columns with NaN for rejected readings, and an event for each channel with some.

    Readings just before the first failure of a channel are rejected as well.
    """
    kinds = ("air" + DEGC, PRESSURE, HUMIDITY)
    kept = {name: values.copy() for name, values in columns.items()}
    gates: dict[str, ChannelGate] = {}
    for name in kept:
        channel = Channel(name if name in kinds else "other" + DEGC)
        ChannelGate(name, channel, altitude_m, gates)
    if all(_is_plain(gate, kept[name]) for name, gate in gates.items()):
        return kept, ()
    for row, at_s in enumerate(time_s.tolist()):
        for name, gate in gates.items():
            value, was_well = float(kept[name][row]), not gate.why
            if math.isnan(value) or not gate.check(at_s, value):
                continue
            is_early = was_well and at_s - time_s[0] < STEADY_S
            gate.left_out += row if is_early else 0
            kept[name][0 if is_early else row : row + 1] = np.nan
    told = [gate.describe() for gate in gates.values() if gate.left_out]
    return kept, tuple(RunEvent(0, IMPLAUSIBLE, text) for text in told)


def _is_plain(gate: ChannelGate, values: NDArray[np.float64]) -> bool:
    low, high = gate.channel.plausible
    at_once, _ = _STEP[gate.channel.unit]
    if gate.is_near:  # so that none can be far from the others
        low, high = max(low, _PLAIN_DEGC[0]), min(high, _PLAIN_DEGC[1])
    is_well = (low <= values) & (values <= high) & (abs(values) > 1.0)
    return bool(is_well.all() and (abs(np.diff(values)) <= at_once).all())
