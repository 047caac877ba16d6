"""The bytes of a link as they came, for the Run."""

from __future__ import annotations

import threading


class ReceivedBytes:
    """A bounded number of bytes; the oldest are dropped. Any thread.

    most : bytes that are kept
    """

    def __init__(self, most: int = 1 << 22) -> None:
        self._most = most
        self._kept = bytearray()
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return len(self._kept)

    def add(self, data: bytes) -> None:
        """Keep bytes that have just been received."""
        with self._lock:
            self._kept += data
            del self._kept[: -self._most]

    def take(self) -> bytes:
        """Bytes since the last call: the answer to `take_link_bytes`."""
        with self._lock:
            data, self._kept = bytes(self._kept), bytearray()
        return data
