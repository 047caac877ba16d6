"""Interface of a port for bytes, and its base over a socket."""

from __future__ import annotations

import select
import socket
from abc import ABC, abstractmethod

from truepath_drivers.interfaces.errors import ConnectionLost


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


BLOCK = 1 << 16


class SocketPort(BytePort):
    """A port that is a socket while it is open."""

    def __init__(self, host: str, port: int) -> None:
        self._address = (host, port)
        self._socket: socket.socket | None = None

    def close(self) -> None:
        opened, self._socket = self._socket, None
        if opened is not None:
            opened.close()

    def require_open(self) -> socket.socket:
        """The open socket. Raises ConnectionLost where there is none."""
        if self._socket is None:
            raise ConnectionLost(f"{self.name} is not open; connect first")
        return self._socket

    def wait(self, timeout_s: float) -> socket.socket | None:
        """The socket once it has bytes; None if none come in time."""
        opened = self.require_open()
        poll = select.poll()
        poll.register(opened, select.POLLIN)
        return opened if poll.poll(timeout_s * 1e3) else None
