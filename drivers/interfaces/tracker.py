"""A laser tracker that streams positions of one reflector."""

from __future__ import annotations

from abc import abstractmethod

from drivers.interfaces.device import Device
from drivers.interfaces.records import LinkHealth, TrackerSamples


class Tracker(Device):
    """Streams samples stamped by its own counter and clock."""

    @abstractmethod
    def start(self, rate_hz: float) -> None:
        """Begin to stream. Idempotent at the same rate.

        Raises Refused if the device cannot do that rate, DeviceTimeout if it is silent.
        """

    @abstractmethod
    def read(self, timeout_s: float) -> TrackerSamples:
        """Return all since the last call, waiting at most `timeout_s` for a first one.

        An empty block means silence. Never holds a sample whose check did not match.
        Raises ConnectionLost if the link has gone.
        """

    @abstractmethod
    def stop(self) -> None:
        """End the stream. Idempotent, any thread, any state."""

    @property
    @abstractmethod
    def health(self) -> LinkHealth:
        """Counts since `connect`."""
