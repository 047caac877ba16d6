"""Ports of a simulated device: a pseudo-terminal or a TCP listener. Nothing blocks.

A port is a set of descriptors to wait for and a channel for bytes; it never waits.
"""

from __future__ import annotations

import contextlib
import os
import socket
import tty
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from truepath_simulators.errors import SimulatorError

_BLOCK = 1 << 16
_PTYS = "/dev/pts/"


class Port(ABC):
    """One host at the other end, or none."""

    @property
    @abstractmethod
    def address(self) -> dict[str, str | int]:
        """Address for a host: `port` (a path), or `host` and `port` (a number)."""

    @abstractmethod
    def descriptors(self) -> list[int]:
        """Descriptors that become readable when there is something to do."""

    @abstractmethod
    def list_blocked_descriptors(self) -> list[int]:
        """Descriptors that become writable when waiting bytes can be sent."""

    @abstractmethod
    def receive(self) -> bytes | None:
        """Bytes that have arrived; b"" if none have, None if the host has gone."""

    @abstractmethod
    def send(self, data: bytes) -> None:
        """Queue bytes and send what the other end accepts now."""

    @property
    @abstractmethod
    def waiting_bytes(self) -> int:
        """Bytes that the other end has not accepted yet."""

    @abstractmethod
    def disconnect(self) -> None:
        """Break the connection like a pulled cable; a host can connect again."""

    @abstractmethod
    def close(self) -> None:
        """Release the port."""

    def converse(
        self, answer: Callable[[bytes], bytes], on_lost: Callable[[], None]
    ) -> None:
        """Answer all that has arrived, and tell where the host has gone."""
        while (data := self.receive()) != b"":
            if data is None:
                on_lost()
            else:
                self.send(answer(data))


class PtyPort(Port):
    """A pseudo-terminal, raw at both ends; the host opens its name like a serial port.

    link : path of a symbolic link to it, which stays when the terminal changes
    """

    def __init__(self, link: Path | None = None) -> None:
        self._link = link
        self._waiting = b""
        if link is not None:
            require_free(link)
        self._open()

    @property
    def address(self) -> dict[str, str | int]:
        """The link if there is one, else the terminal."""
        return {"port": str(self._link or self._name)}

    def descriptors(self) -> list[int]:
        return [self._master]

    def list_blocked_descriptors(self) -> list[int]:
        return [self._master] if self._waiting else []

    def receive(self) -> bytes | None:
        try:
            return os.read(self._master, _BLOCK)
        except BlockingIOError:
            return b""

    def send(self, data: bytes) -> None:
        """Write what the terminal accepts: 16 kB if no host reads."""
        self._waiting += data
        with contextlib.suppress(BlockingIOError):
            while self._waiting:
                self._waiting = self._waiting[os.write(self._master, self._waiting) :]

    @property
    def waiting_bytes(self) -> int:
        return len(self._waiting)

    def disconnect(self) -> None:
        """Open another terminal under the same link, then hang up the old one."""
        old = self._master, self._slave
        self._open()
        for descriptor in old:
            os.close(descriptor)

    def close(self) -> None:
        os.close(self._master)
        os.close(self._slave)
        if self._link is not None and os.path.realpath(self._link) == self._name:
            self._link.unlink(missing_ok=True)

    def _open(self) -> None:
        # The slave stays open here, else the terminal hangs up when a host closes it.
        self._master, self._slave = os.openpty()
        tty.setraw(self._master)
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self._name = os.ttyname(self._slave)
        self._waiting = b""
        if self._link is not None:
            fresh = self._link.with_name(self._link.name + ".new")
            fresh.unlink(missing_ok=True)
            fresh.symlink_to(self._name)
            fresh.replace(self._link)


def require_free(link: Path) -> None:
    """Raises SimulatorError if a link must not replace what is there.

    A link to a missing terminal was left by a rig that has ended.
    """
    is_left = link.is_symlink() and str(link.readlink()).startswith(_PTYS)
    if link.exists() or (link.is_symlink() and not is_left):
        raise SimulatorError(
            f"{link} exists; another rig may use it: give another folder for the links"
        )


class TcpPort(Port):
    """A listener for one host at a time; further ones are rejected."""

    def __init__(self, host: str, port: int) -> None:
        self._listener = socket.create_server((host, port), backlog=4)
        self._listener.setblocking(False)
        self._host: socket.socket | None = None
        self._waiting = b""

    @property
    def address(self) -> dict[str, str | int]:
        host, port = self._listener.getsockname()[:2]
        return {"host": host, "port": port}

    def descriptors(self) -> list[int]:
        descriptors = [self._listener.fileno()]
        if self._host is not None:
            descriptors.append(self._host.fileno())
        return descriptors

    def list_blocked_descriptors(self) -> list[int]:
        if self._host is None or not self._waiting:
            return []
        return [self._host.fileno()]

    def receive(self) -> bytes | None:
        """Bytes of the present host; without any, a new host is accepted."""
        data = self._read_host()
        if data:
            return data
        with contextlib.suppress(BlockingIOError):
            fresh, _ = self._listener.accept()
            # Bytes that it sent before it went are read first: only then its end shows.
            # If it has gone, its last bytes are lost, as on a line that breaks.
            sent = (self._read_host() or b"") + (self._read_host() or b"")
            if self._host is not None:
                fresh.close()
                return sent
            fresh.setblocking(False)
            fresh.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._host = fresh
            return None
        return data

    def _read_host(self) -> bytes | None:
        if self._host is None:
            return b""
        try:
            data = self._host.recv(_BLOCK)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if data:
            return data
        self.disconnect()
        return None

    def send(self, data: bytes) -> None:
        """Send what the connection accepts now; without a host it is lost."""
        if self._host is None:
            return
        self._waiting += data
        try:
            while self._waiting:
                self._waiting = self._waiting[self._host.send(self._waiting) :]
        except BlockingIOError:
            pass
        except OSError:
            self.disconnect()

    @property
    def waiting_bytes(self) -> int:
        return len(self._waiting)

    def linger(self, seconds: bytes) -> None:
        """Set how the end of the connection waits, in the form of `SO_LINGER`."""
        if self._host is not None:
            self._host.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, seconds)

    def disconnect(self) -> None:
        """Close the connection; the listener stays."""
        host, self._host, self._waiting = self._host, None, b""
        if host is not None:
            host.close()

    def close(self) -> None:
        self.disconnect()
        self._listener.close()


def make_port(link: Mapping[str, Any]) -> Port:
    """Port of a tracker's link, in the form of a bench."""
    if link["kind"] == "tcp":
        return TcpPort(link["host"], link["port"])
    return PtyPort(Path(link["symlink"]) if link["symlink"] else None)
