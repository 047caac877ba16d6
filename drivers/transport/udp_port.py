"""Datagrams to a port of this host."""

from __future__ import annotations

import socket

from drivers.interfaces.errors import ConnectionLost
from drivers.transport.socket_port import BLOCK, SocketPort


class UdpPort(SocketPort):
    """Listens; each datagram ends a line, whether it says so or not.

    host : address to listen at; empty for all of this host
    """

    @property
    def name(self) -> str:
        """Address and port."""
        return f"udp {self._address[0] or '*'}:{self._address[1]}"

    def open(self) -> None:
        """Take the port of this host."""
        self.close()
        opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            opened.bind(self._address)
        except OSError as error:
            opened.close()
            raise ConnectionLost(
                f"{self.name} cannot be listened at ({error}); "
                "check the address, and whether another program uses the port"
            ) from error
        self._socket = opened

    def read(self, timeout_s: float) -> bytes:
        """Return the next datagram."""
        opened = self.wait(timeout_s)
        if opened is None:
            return b""
        try:
            data = opened.recv(BLOCK)
        except OSError as error:
            raise ConnectionLost(f"{self.name} is gone ({error})") from error
        return data if data.endswith(b"\n") else data + b"\n"

    def write(self, data: bytes) -> None:
        """Refuse: there is nobody to send to."""
        raise ConnectionLost(f"{self.name} listens only; leave commands out")
