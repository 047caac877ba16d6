"""A TCP connection to a device, or to a serial line behind a terminal server."""

from __future__ import annotations

import socket

from truepath_drivers.interfaces.errors import ConnectionLost, DeviceTimeout
from truepath_drivers.transport.byte_port import BLOCK, SocketPort

_CONNECT_TIMEOUT_S = 1.0
_WRITE_TIMEOUT_S = 0.2
# A peer that vanished without a word (power, cable) is found out after 1 + 3 · 1 s.
_KEEP_ALIVE = {"TCP_KEEPIDLE": 1, "TCP_KEEPINTVL": 1, "TCP_KEEPCNT": 3}


class TcpPort(SocketPort):
    """A client socket without Nagle's delay, monitored by keep-alive probes.

    silent_s : after which it is given up where the peer takes no bytes, None: minutes
    """

    def __init__(self, host: str, port: int, silent_s: float | None = None) -> None:
        super().__init__(host, port)
        self._silent_s = silent_s

    @property
    def name(self) -> str:
        return f"{self._address[0]}:{self._address[1]}"

    def open(self) -> None:
        """Connect within one second."""
        self.close()
        try:
            opened = socket.create_connection(self._address, _CONNECT_TIMEOUT_S)
        except OSError as error:
            raise ConnectionLost(
                f"{self.name} cannot be reached ({error}); "
                "check address, port number, power and cable"
            ) from error
        opened.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for option, seconds in _KEEP_ALIVE.items():
            if hasattr(socket, option):
                opened.setsockopt(socket.IPPROTO_TCP, getattr(socket, option), seconds)
        if self._silent_s is not None and hasattr(socket, "TCP_USER_TIMEOUT"):
            silent_ms = round(1000 * self._silent_s)
            opened.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, silent_ms)
        opened.settimeout(_WRITE_TIMEOUT_S)
        self._socket = opened

    def read(self, timeout_s: float) -> bytes:
        """Bytes held by the kernel, at most 64 KiB at once."""
        opened = self.wait(timeout_s)
        if opened is None:
            return b""
        try:
            data = opened.recv(BLOCK)
        except OSError as error:
            raise self._explain_loss(str(error)) from error
        if not data:
            raise self._explain_loss("closed by the device")
        return data

    def write(self, data: bytes) -> None:
        """Send within 0.2 s; a peer that takes longer hangs."""
        try:
            self.require_open().sendall(data)
        except TimeoutError as error:
            raise DeviceTimeout(
                f"{self.name} takes no bytes; the device or its network hangs"
            ) from error
        except OSError as error:
            raise self._explain_loss(str(error)) from error

    def _explain_loss(self, why: str) -> ConnectionLost:
        return ConnectionLost(
            f"{self.name} is gone ({why}); check cable and power, then connect again"
        )
