"""Checks everything that an installation needs, and changes nothing."""

from __future__ import annotations

from collections.abc import Iterator

from truepath.compensation.format_registry import list_formats
from truepath.device_options import DEVICES, read_options
from truepath.kinematics.effects.family import list_families
from truepath.motion.nc_programs.programs import list_dialects
from truepath.operation.computer import check_computer
from truepath.operation.devices import check_devices
from truepath.operation.finding import Finding, Grade
from truepath.operation.running_service import check_service, find_service
from truepath.operation.storage import check_storage
from truepath.plugins import gather, left_out
from truepath.settings import Settings


def examine(settings: Settings) -> Iterator[Finding]:
    """Findings one by one; devices, which may take seconds, come last."""
    running = find_service(settings)
    yield from check_computer()
    yield from check_plugins()
    yield from check_storage(settings)
    yield check_service(settings, running)
    yield from check_devices(settings, running)


def check_plugins() -> Iterator[Finding]:
    """Each installed plug-in that cannot be used."""
    for group in DEVICES.values():
        gather(group, read_options)
    for look in (list_formats, list_families, list_dialects):
        look()
    for why in sorted(left_out):
        yield Finding("plug-ins", Grade.WARNING, *why.rsplit("; ", 1))
