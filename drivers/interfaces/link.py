"""A device that speaks in bytes and lets them be kept for the record."""

from __future__ import annotations

from abc import ABC, abstractmethod


class ByteLink(ABC):
    """Beside its verbs, a device hands out what it received, before any decoding.

    A Run keeps these bytes as a second stream, so that it can be decoded again when a
    codec is corrected. A driver opts in by deriving from this as well.
    """

    @abstractmethod
    def take_link_bytes(self) -> bytes:
        """Return the bytes received since the last call, in order.

        Called at least every second while a stream runs. A driver keeps a bounded
        number of bytes for it and drops the oldest.
        """
