"""Requirements on every group of thermometers. Its sensors are in a habitable room."""

from __future__ import annotations

import math
from collections.abc import Callable

from truepath_drivers import host_clock
from truepath_drivers.conformance.checking import (
    DEVICE_CHECKS,
    TERMS,
    expect,
    require,
    soon,
)
from truepath_drivers.interfaces.errors import ConnectionLost
from truepath_drivers.interfaces.thermometers import Reading, Thermometers

READ_S = 3.0  # one call, some sensors silent
CYCLES = 3

MakeThermometers = Callable[[], Thermometers]


def channels_are_known_before_connect(make: MakeThermometers) -> None:
    """There is a channel, and no name comes twice; `connect` changes none."""
    group = make()
    before = group.channels
    names = [channel.name for channel in before]
    require(bool(names) and len(set(names)) == len(names), f"channels {names}")
    require(group.period_s > 0.0, f"a period of {group.period_s} s")
    with group:
        require(group.channels == before, "connect changed the channels")


def every_channel_is_read(make: MakeThermometers) -> None:
    """Some calls read every channel, and none that does not exist."""
    with make() as group:
        names = {channel.name for channel in group.channels}
        readings = _read_cycles(group)
    read = {reading.channel for reading in readings}
    require(read <= names, f"readings of {sorted(read - names)}, which is no channel")
    require(read == names, f"no reading of {sorted(names - read)}")


def a_reading_is_a_plausible_number_or_a_fault(make: MakeThermometers) -> None:
    """A value has no fault, a fault no value; a value is possible in a machine hall."""
    with make() as group:
        plausible = {c.name: c.plausible for c in group.channels}
        readings = _read_cycles(group)
    for reading in readings:
        told = f"{reading.channel} is {reading.value}, fault {reading.fault!r}"
        has_value = not math.isnan(reading.value)
        require(has_value != bool(reading.fault), told)
        low, high = plausible.get(reading.channel, (-math.inf, math.inf))
        require(not has_value or low <= reading.value <= high, told)


def readings_are_stamped_by_the_hosts_clock(make: MakeThermometers) -> None:
    """A stamp lies within its call, on the monotonic clock, and rises."""
    last_s: dict[str, float] = {}
    with make() as group:
        for _ in range(CYCLES):
            begin_s = host_clock.now_s()
            readings = group.read()
            end_s = host_clock.now_s()
            for reading in readings:
                at_s = reading.host_time_s
                require(begin_s <= at_s <= end_s, f"stamped {at_s - begin_s:g} s off")
                rises = at_s > last_s.get(reading.channel, -math.inf)
                require(rises, f"{reading.channel}: stamps do not rise")
                last_s[reading.channel] = at_s
            host_clock.sleep_s(group.period_s)


def read_is_bounded_in_time(make: MakeThermometers) -> None:
    """A call returns soon, whatever the sensors do."""
    with make() as group:
        for _ in range(CYCLES):
            with soon("read", READ_S):
                group.read()


def a_closed_group_reads_nothing(make: MakeThermometers) -> None:
    """`read` is ConnectionLost before `connect` and after `close`."""
    group = make()
    for _ in range(2):
        expect(ConnectionLost, group.read)
        group.connect()
        group.close()
    expect(ConnectionLost, group.read)


THERMOMETER_CHECKS: tuple[Callable[[MakeThermometers], None], ...] = (
    *DEVICE_CHECKS,
    channels_are_known_before_connect,
    every_channel_is_read,
    a_reading_is_a_plausible_number_or_a_fault,
    readings_are_stamped_by_the_hosts_clock,
    read_is_bounded_in_time,
    a_closed_group_reads_nothing,
)


def _read_cycles(group: Thermometers) -> list[Reading]:
    names = {channel.name for channel in group.channels}
    readings: list[Reading] = []
    deadline_s = host_clock.now_s() + CYCLES * group.period_s + TERMS.get().patience_s
    while host_clock.now_s() < deadline_s:
        readings += group.read()
        if len(readings) >= CYCLES * len(names):
            break
        host_clock.sleep_s(0.1 * group.period_s)
    return readings
