"""Base of ports over a socket."""

from __future__ import annotations

import select
import socket

from truepath_drivers.interfaces.errors import ConnectionLost
from truepath_drivers.transport.byte_port import BytePort

BLOCK = 1 << 16


class SocketPort(BytePort):
    """A port that is a socket while it is open."""

    def __init__(self, host: str, port: int) -> None:
        self._address = (host, port)
        self._socket: socket.socket | None = None

    def close(self) -> None:
        """Release the socket. Idempotent."""
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
