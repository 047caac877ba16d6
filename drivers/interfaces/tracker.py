"""A laser tracker that streams positions of one reflector."""

from __future__ import annotations

from abc import ABC, abstractmethod

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


class ByteLink(ABC):
    """Beside its verbs, a device hands out what it received, before any decoding.

    A Run keeps these bytes as a second stream, so that it can be decoded again when a
    codec is corrected. A driver opts in by deriving from this as well.
    """

    @abstractmethod
    def take_link_bytes(self) -> bytes:
        """Return the bytes received since the last call, in order.

        Called at least every second while a stream runs. A driver keeps a bounded
        number of bytes for it and drops the oldest.
        """
