"""Ports without a wire."""

from truepath_drivers.transport.byte_port import BytePort


class HandPort(BytePort):
    """Gives once what is due; a test puts it there."""

    name = "wire"

    def __init__(self, due: bytes = b"") -> None:
        self.due = due

    def open(self) -> None:
        """Nothing is closed."""

    def close(self) -> None:
        """Nothing is open."""

    def write(self, data: bytes) -> None:
        """Nobody listens."""

    def read(self, timeout_s: float) -> bytes:
        due, self.due = self.due, b""
        return due
