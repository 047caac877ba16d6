"""Reading of thermometers and air during a measurement, in separate threads.

Nothing waits for a sensor: neither the stream, nor the watchdog, nor the end.
"""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

from truepath.errors import MeasurementFailed
from truepath.files.bundle.run import IMPLAUSIBLE
from truepath.files.bundle.sensor_gate import ChannelGate
from truepath.measurement.faults import Fault
from truepath.measurement.run_file.recorder import Recorder
from truepath_drivers import host_clock
from truepath_drivers.interfaces.errors import ConnectionLost, DeviceError
from truepath_drivers.interfaces.records import Identity
from truepath_drivers.interfaces.thermometers import Channel, Reading, Thermometers
from truepath_drivers.interfaces.tracker import AirExchange, AnyTracker, PolledTracker

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
    _reported_kind: str = ""
    _bad_since_s: float | None = None
    _last: float = math.nan
    _changed_s: float = -math.inf
    _reported: set[str] = field(default_factory=set)

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
        if kind in self._reported or (is_lapse and lasts_s < PATIENCE_S):
            return math.nan, None
        self._reported_kind = kind
        self._reported.add(kind)
        text = f"{self.channel.name}: {text}"
        return math.nan, Fault(kind, text, _ACTIONS[kind])

    def _end_fault(self) -> Fault | None:
        self._bad_since_s = None
        kind_before, self._reported_kind = self._reported_kind, ""
        if not kind_before:
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


log = logging.getLogger(__name__)

JOIN_S = 0.5
AIR_PERIOD_S = 5.0
_FASTEST_S = 0.02

OnReadings = Callable[[Mapping[str, float]], None]
"""Receives readings by channel, NaN for none. Called from any thread."""
OnNotice = Callable[[Fault], None]
"""Receives a new fault of a sensor. Called from any thread."""


class TrackerAir(Thermometers):
    """The weather station of a streaming tracker, as a group of channels.

    without : channels of another group
    """

    def __init__(self, source: AirExchange, without: Sequence[str] = ()) -> None:
        names = ("air_degC", "pressure_hPa", "humidity_percent")
        self._source = source
        self._names = [name for name in names if name not in without]
        self._due_s = -math.inf

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Those of no other group; constant readings are normal."""
        return tuple(Channel(name, stuck_s=0.0) for name in self._names)

    @property
    def period_s(self) -> float:
        """Long, because air changes slowly."""
        return AIR_PERIOD_S

    def connect(self) -> Identity:
        """Identity only: the tracker is connected already."""
        return Identity("", "weather station of the tracker", "", "")

    def close(self) -> None:
        """No action: the tracker is closed by its owner."""

    def read(self) -> tuple[Reading, ...]:
        """Air that the tracker corrects for; empty within the period."""
        begin_s = host_clock.now_s()
        if begin_s < self._due_s:
            return ()
        self._due_s = begin_s + self.period_s
        fault, shown = "", dict.fromkeys(self._names, math.nan)
        try:
            air = self._source.read_air()
            shown["air_degC"] = air.temperature_degc
            shown["pressure_hPa"] = air.pressure_hpa
            shown["humidity_percent"] = air.humidity_percent
        except DeviceError as error:
            fault = str(error)
        at_s = 0.5 * (begin_s + host_clock.now_s())
        return tuple(Reading(n, at_s, shown[n], fault) for n in self._names)


def list_groups(
    tracker: AnyTracker, thermometers: Thermometers | None
) -> tuple[Thermometers, ...]:
    """Thermometers and the tracker's own station, where present.

    A polled tracker reports the air with each point.
    """
    groups = () if thermometers is None else (thermometers,)
    if not isinstance(tracker, AirExchange) or isinstance(tracker, PolledTracker):
        return groups
    own = TrackerAir(tracker, name_channels(groups))
    return (*groups, own) if own.channels else groups


def name_channels(groups: Sequence[Thermometers]) -> tuple[str, ...]:
    """Names of all channels, in the order of the groups."""
    return tuple(c.name for group in groups for c in group.channels)


class EnvironmentReader:
    """One thread per group, so that none waits for another."""

    def __init__(
        self,
        groups: Sequence[Thermometers],
        recorder: Recorder,
        on_notice: OnNotice,
        *,
        on_readings: OnReadings = lambda _: None,
        altitude_m: float | None = None,
    ) -> None:
        self._recorder, self._on_notice = recorder, on_notice
        self._on_readings = on_readings
        self._stopping = threading.Event()
        self._gates: dict[str, ChannelGate] = {}
        self._checks = {
            c.name: SensorPlausibility(c, altitude_m, self._gates)
            for group in groups
            for c in group.channels
        }
        self._threads = [
            threading.Thread(
                target=self._run, args=(group,), name="environment", daemon=True
            )
            for group in groups
        ]

    def start(self) -> None:
        """Start the threads."""
        for thread in self._threads:
            thread.start()

    def stop(self) -> None:
        """Stop without waiting for a driver that hangs. Idempotent.

        Reports the number of omitted readings of each sensor, and why.
        """
        is_first = not self._stopping.is_set()
        self._stopping.set()
        for thread in self._threads:
            if thread.ident is not None:
                host_clock.join(thread, JOIN_S)
        for gate in self._gates.values() if is_first else ():
            if gate.left_out:
                text = gate.describe()
                self._on_notice(Fault(IMPLAUSIBLE, text, ""))

    def _run(self, group: Thermometers) -> None:
        try:
            period_s = max(group.period_s, _FASTEST_S)
            while not self._stopping.is_set():
                self._record(_read(group))
                host_clock.wait(self._stopping, period_s)
        except MeasurementFailed as error:
            log.warning("readings of sensors are not recorded any more: %s", error)
        except Exception as error:
            log.exception("the driver of the sensors has failed")
            text = f"the driver of the sensors has failed: {error}"
            action = "the measurement goes on without them; the log has the details"
            self._on_notice(Fault("sensor-silent", text, action))

    def _record(self, readings: Sequence[Reading]) -> None:
        if not readings or self._stopping.is_set():
            return
        values: dict[str, float] = {}
        for reading in readings:
            check = self._checks[reading.channel]
            values[reading.channel], notice = check.assess(reading)
            if notice is not None:
                self._on_notice(notice)
        self._recorder.put_environment(readings[len(readings) // 2].host_time_s, values)
        self._on_readings(values)


def _read(group: Thermometers) -> tuple[Reading, ...]:
    try:
        try:
            return group.read()
        except ConnectionLost:
            group.connect()
            return group.read()
    except DeviceError as error:
        now_s, why = host_clock.now_s(), str(error)
        return tuple(Reading(c.name, now_s, math.nan, why) for c in group.channels)
