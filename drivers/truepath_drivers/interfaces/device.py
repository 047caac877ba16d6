"""What every device can do."""

from __future__ import annotations

from abc import ABC, abstractmethod
from types import TracebackType
from typing import Self

from truepath_drivers.interfaces.records import Identity


class Device(ABC):
    """A device on a port. Construction opens nothing; `connect` does, `close` ends."""

    @abstractmethod
    def connect(self) -> Identity:
        """Open the link and return who answers.

        Raises ConnectionLost, DeviceTimeout, or WrongDevice if another device answers.
        """

    @abstractmethod
    def close(self) -> None:
        """Stop what runs and release the port. Idempotent."""

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
