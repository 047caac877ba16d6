"""Every installed plug-in: its origin, and whether it conforms to its interface.

No device is opened, except the one given to `check_device`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from importlib.metadata import EntryPoint
from typing import Any

from truepath.compensation import conformance as format_conformance
from truepath.compensation import format_registry
from truepath.compensation.format import CompensationFormat
from truepath.device_options import DEVICES, make_device, read_options
from truepath.errors import BadInput, TruepathError
from truepath.kinematics.effects import conformance, family
from truepath.kinematics.effects.family import Family
from truepath.machine_settings import MachineSettings
from truepath.motion.nc_programs import programs
from truepath.motion.nc_programs.dialect import Dialect
from truepath.planning.default_path import default_path
from truepath.plugins import (
    find_origin,
    find_plugins,
    find_point,
    guarding,
    is_ours,
    left_out,
    load_point,
    word_error,
)
from truepath_drivers.conformance.motion import MOTION_CHECKS
from truepath_drivers.conformance.polled_tracker import POLLED_CHECKS
from truepath_drivers.conformance.thermometers import THERMOMETER_CHECKS
from truepath_drivers.conformance.tracker import TRACKER_CHECKS
from truepath_drivers.interfaces.motion import MotionController
from truepath_drivers.interfaces.thermometers import Thermometers
from truepath_drivers.interfaces.tracker import PolledTracker, Tracker

INTERFACE_VERSIONS: Mapping[str, int] = {
    DEVICES["tracker"]: Tracker.interface_version,
    DEVICES["motion"]: MotionController.interface_version,
    DEVICES["thermometer"]: Thermometers.interface_version,
    family.GROUP: Family.interface_version,
    programs.GROUP: Dialect.interface_version,
    format_registry.GROUP: CompensationFormat.interface_version,
}
"""By entry-point group, the version that its plug-ins must conform to."""


@dataclass(frozen=True, slots=True)
class PluginEntry:
    """A plug-in and its checks.

    fault : why it cannot be used; failures : violations of its interface
    was_checked : as far as that is possible without a device
    unproved : what its checks do not see
    """

    group: str
    name: str
    distribution: str
    version: str
    interface_version: int
    fault: str = ""
    failures: tuple[str, ...] = ()
    was_checked: bool = False
    unproved: str = ""

    @property
    def is_well(self) -> bool:
        """Whether no fault and no failure is known."""
        return not self.fault and not self.failures


def list_plugins(*, checks: bool = False) -> Iterator[PluginEntry]:
    """Every plug-in, whatever is wrong with the others.

    checks : test each against its interface, as far as that needs no device
    """
    for group in INTERFACE_VERSIONS:
        for _, point in sorted(find_plugins(group).items()):
            yield _examine(point, checks=checks)


def list_excluded() -> tuple[str, ...]:
    """Plug-ins without a valid name, and broken lists."""
    return tuple(sorted(left_out))


def _examine(point: EntryPoint, *, checks: bool) -> PluginEntry:
    group = point.group.removeprefix("truepath.")
    try:
        factory = load_point(point)
        with guarding(point, "being asked what it is"):
            origin = find_origin(point, factory)
            if point.group in DEVICES.values():
                read_options(point.name, factory)
    except TruepathError as error:
        origin = find_origin(point, None)
        return PluginEntry(
            group, point.name, origin.distribution, origin.version, 0, str(error)
        )
    ours = INTERFACE_VERSIONS[point.group]
    entry = PluginEntry(
        group,
        point.name,
        origin.distribution,
        origin.version,
        origin.interface_version or ours,
    )
    if entry.interface_version != ours:
        text = f"it keeps version {entry.interface_version} of an interface that has"
        return replace(entry, fault=f"{text} version {ours} here; update it")
    check = _CHECKS.get(point.group)
    if not checks or check is None:
        return entry
    try:
        with guarding(point, "its checks"):
            entry = replace(entry, failures=check(point.name), was_checked=True)
            by_itself = point.group == format_registry.GROUP and not is_ours(point)
            return replace(entry, unproved=format_conformance.UNPROVED * by_itself)
    except TruepathError as error:
        return replace(entry, failures=(str(error),), was_checked=True)


def check_device(word: str, settings: MachineSettings) -> PluginEntry:
    """Test a driver against the device in the settings. A controller MOVES."""
    name = getattr(settings, f"{word}_driver", "")
    if word not in DEVICES or not name:
        raise BadInput(f"no {word} is set; devices are {', '.join(DEVICES)}")
    options = getattr(settings, f"{word}_options")
    point = find_point(DEVICES[word], name)
    made = make_device(word, name, options)
    kinds: tuple[tuple[type, tuple[Callable[[Any], None], ...]], ...] = (
        (Tracker, TRACKER_CHECKS),
        (PolledTracker, POLLED_CHECKS),
        (MotionController, MOTION_CHECKS),
        (Thermometers, THERMOMETER_CHECKS),
    )
    checks = next(checks for kind, checks in kinds if isinstance(made, kind))
    failures = _run_checks(checks, lambda: make_device(word, name, options))
    return replace(_examine(point, checks=False), failures=failures, was_checked=True)


def _run_checks(
    checks: tuple[Callable[..., None], ...], *given: object
) -> tuple[str, ...]:
    failures: dict[str, str] = {}  # each once, by its text: the check that found it
    for check in checks:
        try:
            check(*given)
        except Exception as error:
            told = f"{error}" if isinstance(error, AssertionError) else ""
            failures.setdefault(told or word_error(error), check.__name__)
    return tuple(f"{name}: {told}" for told, name in failures.items())


def _check_effect(name: str) -> tuple[str, ...]:
    at = conformance.example_conditions()
    return _run_checks(conformance.CHECKS, family.find_family(name), at)


def _check_dialect(name: str) -> tuple[str, ...]:
    machine = conformance.example_conditions(2).machine
    path = default_path(machine, lines=4)
    programs.write_program(path, machine, name)  # reads it back, and compares
    return ()


def _check_format(name: str) -> tuple[str, ...]:
    kind = format_registry.load_format(name)
    format_registry.describe_format(name, kind)
    return _run_checks(format_conformance.CHECKS, kind)


_CHECKS: Mapping[str, Callable[[str], tuple[str, ...]]] = {
    family.GROUP: _check_effect,
    programs.GROUP: _check_dialect,
    format_registry.GROUP: _check_format,
}
