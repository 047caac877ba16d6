"""A way for bytes to a device and back."""

from __future__ import annotations

from abc import ABC, abstractmethod


class BytePort(ABC):
    """Bytes in order, both ways. One thread reads, any writes, `close` comes last.

    Construction opens nothing. Errors are ConnectionLost, whose text names the port and
    says what to do; a port that was lost is closed and opened anew, never used further.
    """

    @property
    @abstractmethod
    def name(self) -> str:
        """What the port is called in messages."""

    @abstractmethod
    def open(self) -> None:
        """Open the port, raw and for us alone."""

    @abstractmethod
    def read(self, timeout_s: float) -> bytes:
        """Return what has come, as soon as something has; b"" after `timeout_s`."""

    @abstractmethod
    def write(self, data: bytes) -> None:
        """Send all of `data`.

        Raises DeviceTimeout if the port does not take it within its write timeout.
        """

    @abstractmethod
    def close(self) -> None:
        """Release the port. Idempotent."""
