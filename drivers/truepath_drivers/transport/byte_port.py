"""Interface of a port for bytes."""

from __future__ import annotations

from abc import ABC, abstractmethod


class BytePort(ABC):
    """Bytes in order, both ways. One thread reads, any writes, `close` comes last.

    Construction opens nothing. Errors are ConnectionLost, whose text names the port and
    the remedy; a lost port is closed and reopened, never used further.
    """

    @property
    @abstractmethod
    def name(self) -> str:
        """Name of the port in messages."""

    @abstractmethod
    def open(self) -> None:
        """Open the port, raw and exclusively."""

    @abstractmethod
    def read(self, timeout_s: float) -> bytes:
        """Received bytes, as soon as there are any; b"" after `timeout_s`."""

    @abstractmethod
    def write(self, data: bytes) -> None:
        """Send all of `data`.

        Raises DeviceTimeout if the port does not take it within its write timeout.
        """

    @abstractmethod
    def close(self) -> None:
        """Release the port. Idempotent."""
