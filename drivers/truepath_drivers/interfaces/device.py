"""Verbs of every device."""

from __future__ import annotations

from abc import ABC, abstractmethod
from types import TracebackType
from typing import Self

from truepath_drivers.interfaces.records import Identity


class Device(ABC):
    """A device on a port. Construction opens nothing; `connect` does, `close` ends."""

    @abstractmethod
    def connect(self) -> Identity:
        """Open the link and identify the device.

        Raises ConnectionLost, DeviceTimeout, or WrongDevice if another device answers.
        """

    @abstractmethod
    def close(self) -> None:
        """Stop all activity and release the port. Idempotent."""

    def __enter__(self) -> Self:
        self.connect()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
