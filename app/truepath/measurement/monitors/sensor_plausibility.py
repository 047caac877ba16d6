"""Plausibility of sensor readings: a valid number, or a fault text."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from truepath.files.bundle.run import IMPLAUSIBLE
from truepath.files.bundle.sensor_gate import ChannelGate
from truepath.measurement.faults import Fault
from truepath_drivers.interfaces.thermometers import Channel, Reading

SILENT, NO_NUMBER = "sensor-silent", "sensor-no-number"
STUCK, BACK = "sensor-stuck", "sensor-back"
PATIENCE_S = 5.0  # a lost reply is no dead sensor
_ACTIONS: Mapping[str, str] = MappingProxyType(
    {
        SILENT: "look at its cable and power; the measurement goes on without it",
        NO_NUMBER: "look at its wires; the measurement goes on without it",
        IMPLAUSIBLE: "look at its wires, scale and offset; its readings are left out",
        STUCK: "look at the sensor; its readings are left out until they change",
    }
)


@dataclass(slots=True)
class SensorPlausibility:
    """Checks the readings of one channel in the order of time.

    altitude_m, group : as of its gate
    """

    channel: Channel
    altitude_m: float | None = None
    group: dict[str, ChannelGate] = field(default_factory=dict)
    _told: str = ""
    _bad_since_s: float | None = None
    _last: float = math.nan
    _changed_s: float = -math.inf
    _said: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        ChannelGate(self.channel.name, self.channel, self.altitude_m, self.group)

    def assess(self, reading: Reading) -> tuple[float, Fault | None]:
        """The value, NaN where it is implausible, and a new fault if any.

        A silence after good readings is reported after some seconds, anything else at
        once; each kind once.
        """
        kind, text = self._find_fault(reading)
        if not kind:
            return reading.value, self._end_fault()
        if self._bad_since_s is None:
            self._bad_since_s = reading.host_time_s
        lasts_s = reading.host_time_s - self._bad_since_s
        is_lapse = kind == SILENT and not math.isnan(self._last)
        if kind in self._said or (is_lapse and lasts_s < PATIENCE_S):
            return math.nan, None
        self._told = kind
        self._said.add(kind)
        text = f"{self.channel.name}: {text}"
        return math.nan, Fault(kind, text, _ACTIONS[kind])

    def _end_fault(self) -> Fault | None:
        self._bad_since_s = None
        told, self._told = self._told, ""
        if not told:
            return None
        text = f"{self.channel.name} shows readings again"
        return Fault(BACK, text, "")

    def _find_fault(self, reading: Reading) -> tuple[str, str]:
        value = reading.value
        if reading.fault and math.isnan(value):
            return SILENT, reading.fault
        if not math.isfinite(value):
            return NO_NUMBER, "it shows no number"
        if why := self.group[self.channel.name].check(reading.host_time_s, value):
            return IMPLAUSIBLE, why
        if value != self._last:
            self._last, self._changed_s = value, reading.host_time_s
        still_s = reading.host_time_s - self._changed_s
        if 0.0 < self.channel.stuck_s <= still_s:
            return STUCK, f"it has shown {value:g} unchanged for {still_s:.0f} s"
        return "", ""
