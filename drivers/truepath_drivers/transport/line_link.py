"""Lines of text over a port: one request out, lines in, every wait bounded."""

from __future__ import annotations

from truepath_drivers import host_clock
from truepath_drivers.interfaces.errors import ConnectionLost
from truepath_drivers.streams.received_bytes import ReceivedBytes
from truepath_drivers.transport.byte_port import BytePort

_END = b"\r\n"
_KEPT_BYTES = 1 << 20
_LONGEST = 1 << 12  # of a line; more without an end is noise


class LineLink:
    """Requests and replies that end in CR LF. One thread talks, any closes.

    lines : received since `open`
    """

    def __init__(self, port: BytePort) -> None:
        self._port = port
        self._is_open = False
        self._rest = b""
        self._kept = ReceivedBytes(_KEPT_BYTES)
        self.lines = 0

    @property
    def name(self) -> str:
        return self._port.name

    @property
    def is_open(self) -> bool:
        return self._is_open

    @property
    def has_received(self) -> bool:
        """Whether any bytes have come, also incomplete lines."""
        return bool(self._kept or self._rest)

    def open(self) -> None:
        """Open the port; discards bytes and lines of earlier."""
        self._port.open()
        self._is_open, self._rest, self.lines = True, b"", 0
        self.take_bytes()

    def close(self) -> None:
        self._is_open = False
        self._port.close()

    def send(self, line: bytes, end: bytes = _END) -> None:
        """Send a line, whose end is added."""
        if not self._is_open:
            raise ConnectionLost(f"{self.name} is not connected; connect first")
        try:
            self._port.write(line + end)
        except ConnectionLost:
            self._is_open = False
            raise

    def receive(self, deadline_s: float) -> bytes | None:
        """Next line, None if none is complete by then (`host_clock`)."""
        while _END not in self._rest:
            left_s = deadline_s - host_clock.now_s()
            if left_s <= 0.0:
                return None
            try:
                data = self._port.read(left_s)
            except ConnectionLost:
                self._is_open = False
                raise
            self._kept.add(data)
            self._rest = (self._rest + data)[-_LONGEST:]
        line, self._rest = self._rest.split(_END, 1)
        self.lines += 1
        return line

    def drain(self) -> bytes:
        """Discard pending bytes, which belong to no request; gives them."""
        stale, self._rest = self._rest, b""
        while data := self._port.read(0.0):
            self._kept.add(data)
            stale += data
        return stale

    def take_bytes(self) -> bytes:
        """Bytes since the last call, at most the last 1 MiB."""
        return self._kept.take()
