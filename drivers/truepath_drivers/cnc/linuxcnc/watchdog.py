"""Beats to the watchdog in HAL, over a separate connection."""

from __future__ import annotations

from enum import StrEnum

from truepath_drivers import host_clock
from truepath_drivers.interfaces.errors import (
    ConnectionLost,
    DeviceError,
    DeviceTimeout,
    WrongDevice,
)
from truepath_drivers.transport.byte_port import BytePort


class WatchdogState(StrEnum):
    """State of the watchdog."""

    IDLE = "idle"
    ARMED = "armed"
    TRIPPED = "tripped"


class WatchdogLink:
    """Commands to `truepath_watchdog.py`, one at a time; the caller locks."""

    def __init__(self, port: BytePort, reply_timeout_s: float) -> None:
        self._port, self._reply_timeout_s = port, reply_timeout_s
        self._is_open = False

    def open(self) -> None:
        """Connect and confirm that a watchdog answers."""
        self._port.open()
        self._is_open = True
        self.tell("state")

    def tell(self, command: str) -> WatchdogState:
        """Send `beat`, `arm`, `disarm` or `state`; gives the state after it."""
        reply = self._ask(command)
        try:
            return WatchdogState(reply)
        except ValueError as error:
            self.close()
            raise WrongDevice(
                f"{self._port.name} does not answer as Truepath's watchdog ({error}); "
                "check watchdog_port"
            ) from error

    def list_dead(self) -> str:
        """Names of LinuxCNC's processes that have stopped, separated by spaces."""
        return " ".join(self._ask("dead").split()[1:])

    def _ask(self, command: str) -> str:
        if not self._is_open:
            self._port.open()
            self._is_open = True
        try:
            self._port.write(command.encode() + b"\n")
            return self._read_line()
        except DeviceError:
            self.close()
            raise

    def close(self) -> None:
        """Close the connection. Idempotent."""
        self._is_open = False
        self._port.close()

    def _read_line(self) -> str:
        deadline_s = host_clock.now_s() + self._reply_timeout_s
        line = b""
        while not line.endswith(b"\n"):
            left_s = deadline_s - host_clock.now_s()
            if left_s <= 0:
                raise DeviceTimeout(
                    f"{self._port.name}: the watchdog has not answered in "
                    f"{self._reply_timeout_s:g} s"
                )
            data = self._port.read(left_s)
            if len(line) > 100:
                raise ConnectionLost(f"{self._port.name} sends something else")
            line += data
        return line.decode("ascii", "replace").strip()
