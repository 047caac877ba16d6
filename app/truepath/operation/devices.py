"""The machine file, serial ports and devices of the settings.

A device is only asked for its identity, and only where no running service holds its
port: that service is queried instead. Nothing moves.
"""

from __future__ import annotations

import grp
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Any

from truepath.device_options import make_device
from truepath.errors import BadInput, TruepathError
from truepath.files.bundle.machine_file import read_machine
from truepath.machine_settings import DeviceConfiguration, MachineSettings
from truepath.operation.finding import Finding, Grade
from truepath.operation.running_service import RunningService
from truepath.settings import Settings
from truepath_drivers.interfaces.errors import DeviceError
from truepath_drivers.interfaces.records import Identity
from truepath_drivers.interfaces.thermometers import ReadingTry

_PORT_OPTIONS = ("port", "serial_port")


def check_devices(settings: Settings, running: RunningService) -> Iterator[Finding]:
    """Each machine of the settings, its ports and devices."""
    if settings.simulated:
        yield Finding("devices", Grade.OK, "simulated")
        return
    machines = settings.list_machines()
    if not machines:
        yield check_machine(None)
        return
    for machine_id, one in machines.items():
        for found in _check_one(one, running):
            named = f"{machine_id} {found.subject}"
            yield found if len(machines) == 1 else replace(found, subject=named)
    if running.is_there:
        yield read_cell(running)


def _check_one(settings: MachineSettings, running: RunningService) -> Iterator[Finding]:
    yield check_machine(settings.machine_file)
    for word, name, options in _list_devices(settings):
        yield from check_port(word, options)
        if not running.is_there:
            yield from query_device(word, name, options)


def _list_devices(
    settings: DeviceConfiguration,
) -> Iterator[tuple[str, str, Mapping[str, Any]]]:
    yield "tracker", settings.tracker_driver, settings.tracker_options
    yield "motion", settings.motion_driver, settings.motion_options
    if settings.thermometer_driver:
        yield "thermometer", settings.thermometer_driver, settings.thermometer_options


def check_machine(file: Path | None) -> Finding:
    """Whether the machine file can be read."""
    if file is None:
        remedy = "set machine_file to drive a machine"
        return Finding("machine", Grade.WARNING, "no machine: analyses only", remedy)
    try:
        machine = read_machine(file)
    except TruepathError as error:
        return Finding("machine", Grade.WRONG, str(error), "correct the file")
    except OSError as error:
        text = f"{file}: {error.strerror}"
        return Finding("machine", Grade.WRONG, text, "check machine_file")
    return Finding("machine", Grade.OK, f"{machine.name}, {machine.chain}")


def check_port(word: str, options: Mapping[str, Any]) -> Iterator[Finding]:
    """Whether a serial port of a device exists and may be opened."""
    named = [options[name] for name in _PORT_OPTIONS if name in options]
    for port in (Path(p) for p in named if isinstance(p, str) and p.startswith("/")):
        subject = f"{word} port"
        if not port.exists():
            text = f"{port} is not there"
            yield Finding(subject, Grade.WRONG, text, "plug the adapter in")
        elif not os.access(port, os.R_OK | os.W_OK):
            text = f"{port}: this account may not open it"
            group = _find_group(port)
            remedy = f"add the account to the group {group}, then log in anew"
            yield Finding(subject, Grade.WRONG, text, remedy)
        elif str(port).startswith("/dev/ttyUSB"):
            text = f"{port} may be another adapter after the next plug"
            remedy = "name it by /dev/serial/by-id/..."
            yield Finding(subject, Grade.WARNING, text, remedy)
        else:
            yield Finding(subject, Grade.OK, str(port))


def _find_group(port: Path) -> str:
    number = port.stat().st_gid
    try:
        return grp.getgrgid(number).gr_name
    except KeyError:
        return str(number)


def query_device(word: str, name: str, options: Mapping[str, Any]) -> Iterator[Finding]:
    """Identity of a device, and its sensors by each way to read them."""
    try:
        device = make_device(word, name, options)
    except BadInput as error:
        yield Finding(word, Grade.WRONG, str(error), "correct the settings")
        return
    try:
        yield _describe(word, device.connect())
    except DeviceError as error:
        yield _word(word, Grade.WRONG, f"{name}: {error}")
    finally:
        with suppress(DeviceError):
            device.close()
    if word == "thermometer":
        for channel, ways in groupby(device.tries, lambda one: one.channel):
            yield _compare_ways(channel, [*ways])


def _describe(word: str, who: Identity) -> Finding:
    text = f"{who.maker} {who.model}, serial {who.serial_number}, {who.firmware}"
    if word == "motion" and not who.has_watchdog:
        remedy = "give it a watchdog: it would move on if the service died"
        return Finding(word, Grade.WARNING, f"{text}; no watchdog", remedy)
    return Finding(word, Grade.OK, text)


def _compare_ways(channel: str, ways: Sequence[ReadingTry]) -> Finding:
    shown = [
        f"{w.value} with {w.how}{' (as set)' * w.is_set}{' (likely)' * w.is_likely}"
        for w in ways
    ]
    is_well = ways[0].is_likely
    remedy = "" if is_well else "look at the sensor, its address and order of words"
    grade = Grade.OK if is_well else Grade.WARNING
    return Finding(channel, grade, "; ".join(shown), remedy)


def read_cell(running: RunningService) -> Finding:
    """State of the devices as the running service reports it."""
    if running.system is None:
        return Finding("devices", Grade.UNTOLD, "held by the service that runs")
    cell = running.system["cell"]
    text = f"held by the service, {cell['state']}"
    if cell["connected"] or not cell["text"]:
        return Finding("devices", Grade.OK, text)
    return _word("devices", Grade.WARNING, f"{text}: {cell['text']}")


def _word(subject: str, grade: Grade, said: str) -> Finding:
    text, _, remedy = said.rpartition("; ")
    return Finding(subject, grade, text or remedy, remedy if text else "")
