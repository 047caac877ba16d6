"""Looks at everything that an installation needs, and changes nothing."""

from __future__ import annotations

from collections.abc import Iterator

from truepath.app.operation.computer import look_at_computer
from truepath.app.operation.devices import look_at_devices
from truepath.app.operation.finding import Finding
from truepath.app.operation.running_service import find_service, look_at_service
from truepath.app.operation.storage import look_at_storage
from truepath.app.settings import Settings


def examine(settings: Settings) -> Iterator[Finding]:
    """Yield every finding, as it is found: devices, which may take seconds, at last."""
    running = find_service(settings)
    yield from look_at_computer()
    yield from look_at_storage(settings)
    yield look_at_service(settings, running)
    yield from look_at_devices(settings, running)
