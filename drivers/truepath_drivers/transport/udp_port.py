"""Datagrams to a port of this host."""

from __future__ import annotations

import socket

from truepath_drivers.interfaces.errors import ConnectionLost
from truepath_drivers.transport.byte_port import BLOCK, SocketPort

_KEPT_BYTES = 4 << 20  # as much of it as the system allows


class UdpPort(SocketPort):
    """Receives from one sender; each datagram ends a line, with or without line end.

    host : local address; empty for all of this host
    """

    def __init__(self, host: str, port: int) -> None:
        super().__init__(host, port)
        self._sender: tuple[str, int] | None = None

    @property
    def name(self) -> str:
        return f"udp {self._address[0] or '*'}:{self._address[1]}"

    def open(self) -> None:
        self.close()
        self._sender = None
        opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _KEPT_BYTES)
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
        """Pending datagrams, at least one unless none comes in time."""
        opened = self.wait(timeout_s)
        lines: list[bytes] = []
        while opened is not None and len(lines) < BLOCK:
            try:
                data, sender = opened.recvfrom(BLOCK, socket.MSG_DONTWAIT)
            except BlockingIOError:
                break
            except OSError as error:
                raise ConnectionLost(f"{self.name} is gone ({error})") from error
            if self._sender not in (None, sender):
                raise ConnectionLost(
                    f"{self.name}: {self._sender} and {sender} both send here; "
                    "stop one, or connect again where it has begun anew"
                )
            self._sender = sender
            lines.append(data if data.endswith(b"\n") else data + b"\n")
        return b"".join(lines)

    def write(self, data: bytes) -> None:
        """Raises ConnectionLost: datagrams are only received."""
        raise ConnectionLost(f"{self.name} listens only; leave commands out")
