"""Checks everything that an installation needs, and changes nothing.

A device is only asked for its identity, and only where no running service holds its
port: that service is queried instead. Nothing moves.
"""

from __future__ import annotations

import grp
import os
import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from enum import StrEnum
from importlib.metadata import PackageNotFoundError, requires, version
from itertools import groupby
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement

from truepath.catalogue.database import Database
from truepath.catalogue.errors import StorageUnavailable
from truepath.catalogue.locks import MOUNTS, find_file_system, is_network_share
from truepath.compensation.format_registry import list_formats
from truepath.device_options import DEVICES, make_device, read_options
from truepath.errors import BadInput, TruepathError
from truepath.files.bundle.machine_file import read_machine
from truepath.jobs.dispatch.catalogue_rebuild import check_against_disk
from truepath.kinematics.effects.family import list_families
from truepath.machine_settings import DeviceConfiguration, MachineSettings
from truepath.motion.nc_programs.programs import list_dialects
from truepath.operation.running_service import RunningService, find_service
from truepath.plugins import gather, left_out
from truepath.settings import Settings
from truepath_drivers.interfaces.errors import DeviceError
from truepath_drivers.interfaces.records import Identity
from truepath_drivers.interfaces.thermometers import ReadingTry

LEAST_MEMORY_BYTES = 1 << 30
_MADE = datetime(2026, 1, 1, tzinfo=UTC)  # a clock before that was never set
_ASK_S = 5.0
LEAST_FREE_BYTES = 500 << 20
"""Below it no measurement begins."""
AMPLE_BYTES = 5 << 30


class Grade(StrEnum):
    """Result of a check. `WRONG` prevents measurements; `UNTOLD` is unknown."""

    OK = "ok"
    UNTOLD = "untold"
    WARNING = "warning"
    WRONG = "wrong"


@dataclass(frozen=True, slots=True)
class Finding:
    """A checked subject, the result, and the remedy.

    subject : short, such as `disk`; text : what was found
    remedy : empty where nothing is to be done
    """

    subject: str
    grade: Grade
    text: str
    remedy: str = ""


def examine(settings: Settings) -> Iterator[Finding]:
    """Findings one by one; devices, which may take seconds, come last."""
    running = find_service(settings)
    yield from check_computer()
    yield from check_plugins()
    yield from check_storage(settings)
    yield check_service(settings, running)
    yield from check_devices(settings, running)


def check_computer() -> Iterator[Finding]:
    """Versions, clock, memory and threads."""
    yield check_versions()
    yield check_clock()
    yield check_memory(Path("/proc/meminfo"))
    yield check_threads()


def check_versions() -> Finding:
    """Whether the libraries have the versions that this package requires."""
    python = ".".join(map(str, sys.version_info[:3]))
    ours = f"Truepath {version('truepath')}, Python {python}"
    wrong = list(_list_wrong_versions())
    if not wrong:
        return Finding("versions", Grade.OK, ours)
    text = f"{ours}; {'; '.join(wrong)}"
    remedy = "install again with the constraints: pip install -c constraints.txt ."
    return Finding("versions", Grade.WRONG, text, remedy)


def _list_wrong_versions() -> Iterator[str]:
    for line in requires("truepath") or ():
        need = Requirement(line)
        if need.marker is not None and not need.marker.evaluate({"extra": ""}):
            continue
        try:
            found = version(need.name)
        except PackageNotFoundError:
            yield f"{need.name} is missing"
            continue
        if not need.specifier.contains(found, prereleases=True):
            yield f"{need.name} is {found}, not {need.specifier}"


def check_clock(now: datetime | None = None) -> Finding:
    """Whether the clock is set and synchronised, as far as the system reports it."""
    now = now or datetime.now(UTC)
    shown = f"{now:%Y-%m-%d %H:%M:%S} UTC"
    if now < _MADE:
        remedy = "set the date: Runs and results bear it"
        return Finding("clock", Grade.WRONG, f"{shown} is before this version", remedy)
    kept = _is_clock_synchronised()
    if kept is None:
        remedy = "compare it with another clock; set it if it is wrong"
        text = f"{shown}; nobody says who keeps it"
        return Finding("clock", Grade.UNTOLD, text, remedy)
    if kept:
        return Finding("clock", Grade.OK, f"{shown}, kept by the network")
    remedy = "switch time synchronisation on (timedatectl set-ntp true), or set it"
    return Finding("clock", Grade.WARNING, f"{shown}, kept by nobody", remedy)


def _is_clock_synchronised() -> bool | None:
    program = shutil.which("timedatectl")
    if program is None:
        return None
    try:
        told = subprocess.run(  # noqa: S603
            [program, "show", "--property=NTPSynchronized", "--value"],
            capture_output=True,
            text=True,
            timeout=_ASK_S,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return {"yes": True, "no": False}.get(told.stdout.strip())


def check_memory(meminfo: Path) -> Finding:
    """Whether there is memory for an analysis; `meminfo` as Linux writes it."""
    try:
        lines = meminfo.read_text(encoding="ascii").splitlines()
        told = dict(line.split(":", 1) for line in lines)
        free = int(told["MemAvailable"].split()[0]) << 10
    except (OSError, KeyError, ValueError):
        remedy = "see that 1 GB is free before the analysis of a long Run"
        text = "the system does not tell"
        return Finding("memory", Grade.UNTOLD, text, remedy)
    text = f"{free / 1e9:.1f} GB are free"
    if free >= LEAST_MEMORY_BYTES:
        return Finding("memory", Grade.OK, text)
    remedy = "end other programs: an analysis of a long Run takes about 1 GB"
    return Finding("memory", Grade.WARNING, text, remedy)


def check_threads() -> Finding:
    """Whether linear algebra is limited to one thread per process."""
    several = {
        name: value
        for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
        if (value := os.environ.get(name, "1")) != "1"
    }
    if not several:
        return Finding("threads", Grade.OK, "linear algebra: one thread a process")
    text = ", ".join(f"{name}={value}" for name, value in several.items())
    remedy = "leave them unset: several threads a process wait for each other"
    return Finding("threads", Grade.WARNING, text, remedy)


def check_plugins() -> Iterator[Finding]:
    """Each installed plug-in that cannot be used."""
    for group in DEVICES.values():
        gather(group, read_options)
    for look in (list_formats, list_families, list_dialects):
        look()
    for why in sorted(left_out):
        yield Finding("plug-ins", Grade.WARNING, *why.rsplit("; ", 1))


def check_storage(settings: Settings) -> Iterator[Finding]:
    """Rights, file system, room and catalogue of the data folder."""
    folder = settings.data_dir
    place = find_existing(folder)
    yield check_rights(folder, place)
    yield check_file_system(place)
    yield check_room(place)
    yield check_catalogue_file(settings)


def find_existing(folder: Path) -> Path:
    """The folder, or the nearest one above that exists."""
    place = folder.absolute()
    return next(p for p in (place, *place.parents) if p.exists())


def check_rights(folder: Path, place: Path) -> Finding:
    """Whether this account may write; `place` as `find_existing` has it."""
    if not place.is_dir():
        remedy = "give another data_dir"
        return Finding("data folder", Grade.WRONG, f"{place} is no folder", remedy)
    if not os.access(place, os.R_OK | os.W_OK | os.X_OK):
        text = f"{place}: this account may not write there"
        remedy = "give the folder to the account of the service, or set data_dir"
        return Finding("data folder", Grade.WRONG, text, remedy)
    is_new = place != folder.absolute()
    text = f"{folder} does not exist yet; it is made" if is_new else str(folder)
    return Finding("data folder", Grade.OK, text)


def check_file_system(place: Path, mounts: Path = MOUNTS) -> Finding:
    """Whether the folder is on a disk of this computer."""
    kind = find_file_system(place.resolve(), mounts)
    if kind is None:
        remedy = "see that data_dir is on a disk of this computer, not on a share"
        text = "the system does not tell"
        return Finding("file system", Grade.UNTOLD, text, remedy)
    if is_network_share(kind):
        remedy = "set data_dir to a disk of this computer"
        text = f"{place} is on a share of the network ({kind})"
        return Finding("file system", Grade.WRONG, text, remedy)
    return Finding("file system", Grade.OK, kind)


def check_room(place: Path) -> Finding:
    """Whether the disk has room for Runs."""
    free = shutil.disk_usage(place).free
    text = f"{free / 1e9:.1f} GB are free"
    if free < LEAST_FREE_BYTES:
        remedy = "free some space: below 0.5 GB no measurement begins"
        return Finding("disk", Grade.WRONG, text, remedy)
    if free < AMPLE_BYTES:
        remedy = "free some space: an hour of measuring takes about 0.2 GB"
        return Finding("disk", Grade.WARNING, text, remedy)
    return Finding("disk", Grade.OK, text)


def check_catalogue_file(settings: Settings) -> Finding:
    """Whether the catalogue can be used and agrees with the Runs on disk."""
    if not settings.database_url and not settings.data_dir.exists():
        return Finding("catalogue", Grade.OK, "there is none yet")
    database = Database(settings.database)
    try:
        found = check_against_disk(database, settings.data_dir / "runs")
    except StorageUnavailable as error:
        remedy = "look at the database server, or try again"
        return Finding("catalogue", Grade.WRONG, str(error), remedy)
    except TruepathError as error:
        return Finding("catalogue", Grade.WRONG, str(error))
    finally:
        database.close()
    if found["revision"] is None:
        return Finding("catalogue", Grade.OK, "there is none yet")
    text = f"schema {found['revision']}, {found['jobs']} jobs, {found['runs']} Runs"
    gone = len(found["rows_without_file"])
    if gone:
        remedy = "see truepath catalogue check; bring the files back from a backup"
        return Finding(
            "catalogue", Grade.WARNING, f"{text}; files of {gone} have gone", remedy
        )
    return Finding("catalogue", Grade.OK, text)


def check_service(settings: Settings, running: RunningService) -> Finding:
    """Whether the service runs, or could listen at its address."""
    place = f"{settings.host} port {settings.port}"
    if running.system is not None:
        text = f"runs at {place}, version {running.system['version']}"
        return Finding("service", Grade.OK, text)
    if running.answers:
        return Finding("service", Grade.OK, f"runs at {place}; it wants a log-in")
    if running.is_there:
        text = f"a service holds {settings.data_dir} and does not answer at {place}"
        remedy = "give the settings it was started with, or look at its log"
        return Finding("service", Grade.WARNING, text, remedy)
    try:
        family, _, _, _, address = socket.getaddrinfo(
            settings.host, settings.port, type=socket.SOCK_STREAM
        )[0]
        socket.create_server(address[:2], family=family).close()
    except OSError as error:
        remedy = "stop what listens there, or set another port"
        text = f"cannot listen on {place}: {error.strerror}"
        return Finding("service", Grade.WRONG, text, remedy)
    return Finding("service", Grade.OK, f"does not run; could listen on {place}")


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
    named = [options[name] for name in ("port", "serial_port") if name in options]
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
        yield _split_remedy(word, Grade.WRONG, f"{name}: {error}")
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
        remedy = "look at Connect on its page"
        text = "held by the service that runs"
        return Finding("devices", Grade.UNTOLD, text, remedy)
    cell = running.system["cell"]
    text = f"held by the service, {cell['state']}"
    if cell["connected"] or not cell["text"]:
        return Finding("devices", Grade.OK, text)
    return _split_remedy("devices", Grade.WARNING, f"{text}: {cell['text']}")


def _split_remedy(subject: str, grade: Grade, said: str) -> Finding:
    text, _, remedy = said.rpartition("; ")
    return Finding(subject, grade, text or remedy, remedy if text else "")
