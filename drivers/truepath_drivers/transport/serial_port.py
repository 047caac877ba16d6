"""A serial line. POSIX: `poll` and `os.read` cost half of what pyserial's read does."""

from __future__ import annotations

import os
import select
import termios

import serial

from truepath_drivers.interfaces.errors import ConnectionLost, DeviceTimeout
from truepath_drivers.transport.byte_port import BytePort

_WRITE_TIMEOUT_S = 0.2
_BLOCK = 1 << 16


class SerialPort(BytePort):
    """A tty in raw mode, locked against other programs, 8N1 without flow control."""

    def __init__(self, path: str, baudrate: int) -> None:
        self._path = path
        self._baudrate = baudrate
        self._serial: serial.Serial | None = None

    @property
    def name(self) -> str:
        return self._path

    def open(self) -> None:
        """Open the tty raw and exclusively; the text of a failure names the remedy."""
        self.close()
        try:
            self._serial = serial.Serial(
                self._path,
                self._baudrate,
                timeout=0,
                write_timeout=_WRITE_TIMEOUT_S,
                exclusive=True,
            )
        except (OSError, ValueError, termios.error) as error:
            raise ConnectionLost(self._why_not(error)) from error

    def _why_not(self, error: Exception) -> str:
        text = str(error)
        if not os.path.exists(self._path):
            why = "no such port; plug the cable in, or look for it in /dev/serial/by-id"
        elif not os.access(self._path, os.R_OK | os.W_OK):
            why = "no permission; add this user to the group of the port (dialout)"
        elif "lock" in text:
            why = "another program uses it; end that program"
        else:
            why = f"it cannot be opened at {self._baudrate} baud ({text})"
        return f"{self._path}: {why}"

    def read(self, timeout_s: float) -> bytes:
        """Bytes held by the kernel, at most 64 KiB at once."""
        fd = self._require_open().fileno()
        poll = select.poll()
        poll.register(fd, select.POLLIN)
        events = poll.poll(timeout_s * 1e3)
        if not events:
            return b""
        if not events[0][1] & select.POLLIN:
            raise self._explain_loss("it hung up")
        try:
            data = os.read(fd, _BLOCK)
        except OSError as error:
            raise self._explain_loss(str(error)) from error
        if not data:
            raise self._explain_loss("end of file")
        return data

    def write(self, data: bytes) -> None:
        """Send within 0.2 s; a tty that takes longer hangs."""
        try:
            self._require_open().write(data)
        except serial.SerialTimeoutException as error:
            raise DeviceTimeout(
                f"{self._path} takes no bytes; check the cable and flow control"
            ) from error
        except OSError as error:
            raise self._explain_loss(str(error)) from error

    def close(self) -> None:
        port, self._serial = self._serial, None
        if port is not None:
            port.close()

    def _require_open(self) -> serial.Serial:
        if self._serial is None:
            raise ConnectionLost(f"{self._path} is not open; connect first")
        return self._serial

    def _explain_loss(self, why: str) -> ConnectionLost:
        return ConnectionLost(
            f"{self._path} is gone ({why}); check cable and power, then connect again"
        )
