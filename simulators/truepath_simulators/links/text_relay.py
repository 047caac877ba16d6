"""A tracker whose software sends lines of text: it relays any tracker's stream.

`START` and `STOP` come as lines from the one connected host; without them it streams as
soon as a host listens, as it does by datagrams.
"""

from __future__ import annotations

import select
import socket
import threading
from collections.abc import Callable
from typing import Any, Literal, Self

from truepath_drivers.interfaces.records import TrackerSamples
from truepath_drivers.interfaces.tracker import Tracker
from truepath_simulators.links.links import Port, PtyPort, TcpPort

_PERIOD_S = 0.02


class TextRelay:
    """Text lines over TCP, a pseudo-terminal or UDP, from `start` to `close`.

    write_line : line, without its end, of a sample from a block and an index
    """

    def __init__(
        self,
        tracker: Tracker,
        write_line: Callable[[TrackerSamples, int], str],
        *,
        rate_hz: float = 500.0,
        waits_for_start: bool = True,
        link: Literal["tcp", "pty", "udp"] = "tcp",
    ) -> None:
        self._tracker, self._write_line = tracker, write_line
        self._rate_hz, self._waits = rate_hz, waits_for_start and link != "udp"
        self._port = _open_port(link)
        self._streams = False
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="text-relay")

    @property
    def options(self) -> dict[str, Any]:
        """Options of a driver that reads it, found by their addresses."""
        commands = {"start_command": "START", "stop_command": "STOP"}
        return {**self._port.address, **(commands if self._waits else {})}

    def __enter__(self) -> Self:
        self._tracker.connect()
        if not self._waits:
            self._obey(b"START")
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()
        self._port.close()
        self._tracker.close()

    def _serve(self) -> None:
        while not self._ended.is_set():
            received = self._port.receive()
            if received is None and self._waits:  # another host, or none any more
                self._obey(b"STOP")
            self._obey(received or b"")
            if not self._streams:
                select.select(self._port.descriptors(), [], [], _PERIOD_S)
                continue
            block = self._tracker.read(_PERIOD_S)
            lines = [f"{self._write_line(block, k)}\r\n" for k in range(len(block))]
            if lines and self._port.waiting_bytes < 1 << 20:
                self._port.send("".join(lines).encode())

    def _obey(self, data: bytes) -> None:
        for word in data.split():
            if word == b"START":
                self._tracker.start(self._rate_hz)
                self._streams = True
            elif word == b"STOP" and self._streams:
                self._tracker.stop()
                self._tracker.read(0.0)
                self._streams = False


class _UdpPort(Port):
    """Datagrams of a line each to a port of this host, where a driver listens."""

    def __init__(self) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", 0))
            self._to = probe.getsockname()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    @property
    def address(self) -> dict[str, str | int]:
        return {"host": self._to[0], "port": self._to[1], "udp": True}

    def descriptors(self) -> list[int]:
        return []

    def list_blocked_descriptors(self) -> list[int]:
        return []

    def receive(self) -> bytes | None:
        return b""

    def send(self, data: bytes) -> None:
        for line in data.splitlines():
            self._socket.sendto(line, self._to)

    @property
    def waiting_bytes(self) -> int:
        return 0

    def disconnect(self) -> None:
        pass

    def close(self) -> None:
        self._socket.close()


def _open_port(link: str) -> Port:
    if link == "tcp":
        return TcpPort("127.0.0.1", 0)
    return PtyPort() if link == "pty" else _UdpPort()
