"""Modbus masters on TCP connections and on a serial line. Nothing blocks."""

from __future__ import annotations

import contextlib
import socket
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from truepath_simulators.cnc.modbus_wire import (
    GATEWAY_TARGET_SILENT,
    RtuFramer,
    TcpFramer,
    exception,
    rtu_frame,
    tcp_frame,
)
from truepath_simulators.links.links import PtyPort

UNIT = 1
_BROADCAST = 0
_TCP_UNITS = (0, UNIT, 255)
_BLOCK = 4096
# Longer than the pause of a scheduler, shorter than the time-out of a master.
_HALF_REQUEST_S = 0.1

# Answers what is sent to a unit, a PDU; None is silence.
Answer = Callable[[int, bytes], bytes | None]


class ModbusPort(ABC):
    """A port for Modbus masters."""

    @property
    @abstractmethod
    def address(self) -> dict[str, str | int]:
        """Address for masters."""

    @abstractmethod
    def descriptors(self) -> list[int]:
        """Descriptors that become readable when there is something to do."""

    @abstractmethod
    def serve(self, answer: Answer) -> None:
        """Answer every request that has arrived."""

    @abstractmethod
    def disconnect(self) -> None:
        """Break all connections."""

    @abstractmethod
    def close(self) -> None:
        """Release the port."""


class ModbusTcpPort(ModbusPort):
    """A listener with any number of connections; other units are not reached."""

    def __init__(self, host: str, port: int, units: Sequence[int] = _TCP_UNITS) -> None:
        self._units = units
        self._listener = socket.create_server((host, port), backlog=16)
        self._listener.setblocking(False)
        self._masters: dict[socket.socket, TcpFramer] = {}

    @property
    def address(self) -> dict[str, str | int]:
        """Host and port, as bound."""
        host, port = self._listener.getsockname()[:2]
        return {"host": host, "port": port}

    def descriptors(self) -> list[int]:
        """The listener and every connection."""
        return [self._listener.fileno(), *(m.fileno() for m in self._masters)]

    def serve(self, answer: Answer) -> None:
        """Accept new masters and answer all."""
        self._accept()
        for master in list(self._masters):
            try:
                self._serve_one(master, answer)
            except BlockingIOError:
                continue
            except OSError:
                self._drop(master)

    def disconnect(self) -> None:
        """Close every connection; the listener stays."""
        for master in list(self._masters):
            self._drop(master)

    def close(self) -> None:
        """Close the connections and the listener."""
        self.disconnect()
        self._listener.close()

    def _accept(self) -> None:
        with contextlib.suppress(BlockingIOError):
            while True:
                master, _ = self._listener.accept()
                master.setblocking(False)
                master.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._masters[master] = TcpFramer()

    def _serve_one(self, master: socket.socket, answer: Answer) -> None:
        data = master.recv(_BLOCK)
        requests = self._masters[master].feed(data) if data else None
        if requests is None:
            self._drop(master)
            return
        for transaction, unit, pdu in requests:
            if unit in self._units:
                reply = answer(unit, pdu)
            else:
                reply = exception(pdu, GATEWAY_TARGET_SILENT)
            if reply is not None:
                master.send(tcp_frame(transaction, unit, reply))

    def _drop(self, master: socket.socket) -> None:
        del self._masters[master]
        master.close()


class ModbusRtuPort(ModbusPort):
    """A pseudo-terminal in place of a serial line with devices."""

    def __init__(self, link: Path | None, units: Sequence[int] = (UNIT,)) -> None:
        self._units = units
        self._pty = PtyPort(link)
        self._framer = RtuFramer()
        self._heard_s = 0.0

    @property
    def address(self) -> dict[str, str | int]:
        """Path of the terminal."""
        return {"serial_port": self._pty.address["port"]}

    def descriptors(self) -> list[int]:
        """The terminal."""
        return self._pty.descriptors()

    def serve(self, answer: Answer) -> None:
        """Answer requests to our units; a broadcast (unit 0) has no answer."""
        data = self._pty.receive()
        if not data:
            return
        now_s = time.monotonic()
        if now_s - self._heard_s > _HALF_REQUEST_S:
            self._framer.expire()
        self._heard_s = now_s
        for unit, pdu in self._framer.feed(data):
            is_ours = unit == _BROADCAST or unit in self._units
            reply = answer(unit, pdu) if is_ours else None
            if reply is not None and unit != _BROADCAST:
                self._pty.send(rtu_frame(unit, reply))

    def disconnect(self) -> None:
        """Hang up the terminal; a new one takes its name."""
        self._pty.disconnect()

    def close(self) -> None:
        """Close the terminal."""
        self._pty.close()


def make_modbus_ports(
    link: Mapping[str, Any],
    *,
    tcp_units: Sequence[int] = _TCP_UNITS,
    rtu_units: Sequence[int] = (UNIT,),
) -> dict[str, ModbusPort]:
    """Ports of a device's link, in the form of a bench."""
    tcp = ModbusTcpPort(link["host"], link["port"], tcp_units)
    ports: dict[str, ModbusPort] = {"tcp": tcp}
    if link["rtu"]:
        symlink = link["rtu_symlink"]
        ports["rtu"] = ModbusRtuPort(Path(symlink) if symlink else None, rtu_units)
    return ports
