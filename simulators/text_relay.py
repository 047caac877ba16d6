"""A tracker whose software sends lines of text: it relays any tracker's stream.

`START` and `STOP` come as lines from the one host that is connected; without them it
streams as soon as somebody listens.
"""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from types import TracebackType
from typing import Self

from drivers.interfaces.records import TrackerSamples
from drivers.interfaces.tracker import Tracker

_PERIOD_S = 0.02


class TextRelay:
    """A TCP server of text lines on this host, from `start` to `close`.

    write_line : a block of samples and the index of one to a line without its end
    """

    def __init__(
        self,
        tracker: Tracker,
        write_line: Callable[[TrackerSamples, int], str],
        *,
        rate_hz: float = 500.0,
        waits_for_start: bool = True,
    ) -> None:
        self._tracker, self._write_line = tracker, write_line
        self._rate_hz, self._waits = rate_hz, waits_for_start
        self._server = socket.create_server(("127.0.0.1", 0))
        self._server.settimeout(_PERIOD_S)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="text-relay")

    @property
    def port(self) -> int:
        """Number of its TCP port."""
        return int(self._server.getsockname()[1])

    def __enter__(self) -> Self:
        self._tracker.connect()
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._ended.set()
        self._thread.join()
        self._server.close()
        self._tracker.close()

    def _serve(self) -> None:
        while not self._ended.is_set():
            try:
                host, _ = self._server.accept()
            except TimeoutError:
                continue
            with host, suppress(OSError):  # the host has gone; the next may come
                self._relay(host)
            self._tracker.stop()

    def _relay(self, host: socket.socket) -> None:
        host.settimeout(1.0)
        if not self._waits:
            self._tracker.start(self._rate_hz)
        while not self._ended.is_set():
            host.setblocking(False)
            try:
                data = host.recv(4096)
                if not data:
                    return
                self._obey(data)
            except BlockingIOError:
                pass
            host.settimeout(1.0)
            block = self._tracker.read(_PERIOD_S)
            lines = [self._write_line(block, k) for k in range(len(block))]
            if lines:
                host.sendall("".join(f"{line}\r\n" for line in lines).encode())

    def _obey(self, data: bytes) -> None:
        for word in data.split():
            if word == b"START":
                self._tracker.start(self._rate_hz)
            elif word == b"STOP":
                self._tracker.stop()
                self._tracker.read(0.0)
