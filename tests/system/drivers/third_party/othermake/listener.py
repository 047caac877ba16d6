"""Listens to the port: samples for whoever reads, replies for whoever asks."""

from __future__ import annotations

import threading
from collections import deque

from othermake.lines import MAX_LINE, Continuation, Sample, check
from truepath_drivers.interfaces.errors import ConnectionLost, DeviceError
from truepath_drivers.interfaces.records import LinkHealth
from truepath_drivers.transport.byte_port import BytePort

_LOOK_S = 0.1
_SAMPLES = 30_000  # ten minutes at 50 Hz
_LINK_BYTES = 1 << 22


class Listener:
    """A thread from `start` to `close`.

    error : why it has ended by itself
    """

    def __init__(self, port: BytePort) -> None:
        self.error: DeviceError | None = None
        self._port, self._rest = port, b""
        self._continuation = Continuation()
        self._samples: deque[Sample] = deque(maxlen=_SAMPLES)
        self._replies: deque[str] = deque()
        self._link_bytes = bytearray()
        self._good_lines = self._bad_lines = self._bad_bytes = 0
        self._news, self._ending = threading.Condition(), threading.Event()
        self._thread = threading.Thread(target=self._run, name=port.name, daemon=True)

    def start(self) -> None:
        """Begin to listen."""
        self._thread.start()

    def close(self) -> None:
        """End the thread."""
        self._ending.set()
        self._thread.join()

    @property
    def health(self) -> LinkHealth:
        """Counts since the beginning."""
        return LinkHealth(
            frames=self._good_lines,
            lost_samples=self._continuation.lost,
            crc_errors=self._bad_lines,
            skipped_bytes=self._bad_bytes,
        )

    def take_samples(self, timeout_s: float) -> list[Sample]:
        """Return what has come since the last call, waiting so long for a first one."""
        with self._news:
            self._news.wait_for(lambda: self._samples or self.error, timeout_s)
            if not self._samples and self.error is not None:
                raise self.error
            taken = list(self._samples)
            self._samples.clear()
        return taken

    def take_reply(self, timeout_s: float) -> str | None:
        """Return the next reply, None if there is none in time."""
        with self._news:
            self._news.wait_for(lambda: self._replies or self.error, timeout_s)
            if not self._replies and self.error is not None:
                raise self.error
            return self._replies.popleft() if self._replies else None

    def forget_replies(self) -> None:
        """Forget replies that came too late."""
        with self._news:
            self._replies.clear()

    def take_bytes(self) -> bytes:
        """Return the bytes since the last call."""
        with self._news:
            taken = bytes(self._link_bytes[-_LINK_BYTES:])
            self._link_bytes.clear()
        return taken

    def _run(self) -> None:
        while not self._ending.is_set():
            try:
                data = self._port.read(_LOOK_S)
            except ConnectionLost as error:
                with self._news:
                    self.error = error
                    self._news.notify_all()
                return
            if data:
                with self._news:
                    self._take(data)
                    self._news.notify_all()

    def _take(self, data: bytes) -> None:
        self._link_bytes += data
        *lines, self._rest = (self._rest + data).split(b"\n")
        self._rest = self._rest[-MAX_LINE:]
        for line in lines:
            text = check(line)
            if text is None or not self._sort(text):
                self._bad_lines += 1
                self._bad_bytes += len(line)
            else:
                self._good_lines += 1

    def _sort(self, text: str) -> bool:
        kind, *fields = text.split(" ")
        try:
            if kind == "S":
                self._samples.append(self._continuation.take(fields))
                return True
            if kind == "GO":
                self._continuation.begin(float(fields[1]))
            elif kind == "HALT":
                self._continuation.end(int(fields[0]))
        except (ValueError, IndexError):
            return False
        self._replies.append(text)
        return True
