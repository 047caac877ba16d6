"""Temperature sensors of the machine."""

from __future__ import annotations

from abc import abstractmethod

from drivers.interfaces.device import Device
from drivers.interfaces.records import TemperatureSamples


class Thermometer(Device):
    """Reads named sensors."""

    @abstractmethod
    def read(self) -> TemperatureSamples:
        """Return one row of temperatures, stamped with the host's monotonic clock."""
