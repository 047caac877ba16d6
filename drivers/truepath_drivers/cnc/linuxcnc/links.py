"""The two connections to LinuxCNC: linuxcncrsh, and the watchdog in HAL."""

from __future__ import annotations

import re
from enum import StrEnum

from truepath_drivers import host_clock
from truepath_drivers.interfaces.errors import (
    ConnectionLost,
    DeviceError,
    DeviceTimeout,
    WrongDevice,
)
from truepath_drivers.transport.byte_port import BytePort

_LINE = re.compile(rb"[\r\n]*([^\r\n]+)[\r\n]")
_NO_ERROR = "OK"
_MOST_ERRORS = 50


class RshLink:
    """Requests from the calling thread, one at a time; the caller locks.

    A request without a reply closes the connection: the next reply would be taken for
    this one. Only one connection at a time may command, the last that enabled itself.
    """

    def __init__(
        self,
        port: BytePort,
        password: str,
        enable_password: str,
        reply_timeout_s: float,
    ) -> None:
        self._port, self._reply_timeout_s = port, reply_timeout_s
        self._password, self._enable_password = password, enable_password
        self._rest = b""
        self.is_open = False
        self.version = ""

    @property
    def name(self) -> str:
        return self._port.name

    def open(self) -> None:
        """Connect, identify, and take the command."""
        self._port.open()
        self._rest, self.is_open = b"", True
        try:
            hello = self.request(f"hello {self._password} truepath 1")
            if not hello.startswith("HELLO ACK"):
                raise WrongDevice(
                    f"{self.name} answers {hello!r}, which is not linuxcncrsh's "
                    "welcome; check port and password"
                )
            self.version = hello.removeprefix("HELLO ACK").strip()
            self.request("set echo off")  # this line still comes back
            self.request("set verbose on")
            self.enable()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        self.is_open = False
        self._port.close()

    def enable(self) -> bool:
        """Take the command from any other connection; true if we have it."""
        return self.order(f"enable {self._enable_password}")

    def read(self, what: str) -> str:
        """Value of `get what`."""
        reply = self.request(f"get {what}")
        name, _, value = reply.partition(" ")
        if name.lower() != what.split()[0].lower():
            raise self._fail(f"{self.name} answers {reply!r} to 'get {what}'")
        return value.strip()

    def order(self, what: str) -> bool:
        """Send `set what`; true if it was received, which does not mean accepted."""
        reply = self.request(f"set {what}").upper()
        expected = f"SET {what.split()[0].upper()} "
        if not reply.startswith(expected):
            raise self._fail(f"{self.name} answers {reply!r} to 'set {what}'")
        return reply.removeprefix(expected).strip() == "ACK"

    def pop_errors(self) -> list[str]:
        """Pending messages, oldest first; empties their queue."""
        errors: list[str] = []
        while len(errors) < _MOST_ERRORS:
            text = self.read("error")
            if text.upper() == _NO_ERROR:
                break
            errors.append(text)
        return errors

    def request(self, line: str) -> str:
        """Send a line, wait for the reply. Raises ConnectionLost, DeviceTimeout."""
        if not self.is_open:
            raise ConnectionLost(f"{self.name} is not connected; connect first")
        deadline_s = host_clock.now_s() + self._reply_timeout_s
        try:
            self._port.write(line.encode("ascii", "replace") + b"\r\n")
            while not (found := _LINE.match(self._rest)):
                left_s = deadline_s - host_clock.now_s()
                if left_s <= 0:
                    raise DeviceTimeout(
                        f"{self.name} has not answered in {self._reply_timeout_s:g} s; "
                        "LinuxCNC hangs, or something else listens there"
                    )
                self._rest += self._port.read(left_s)
        except (ConnectionLost, DeviceTimeout):
            self.close()
            raise
        self._rest = self._rest[found.end() :]
        return found.group(1).decode("ascii", "replace").strip()

    def _fail(self, text: str) -> ConnectionLost:
        self.close()
        return ConnectionLost(f"{text}; the connection is out of step, connect again")


class WatchdogState(StrEnum):
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
        self.send("state")

    def send(self, command: str) -> WatchdogState:
        """Send `beat`, `arm`, `disarm` or `state`; gives the state after it."""
        reply = self._request(command)
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
        return " ".join(self._request("dead").split()[1:])

    def _request(self, command: str) -> str:
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
