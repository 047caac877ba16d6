"""Modbus on the device side: requests in, answers out, over TCP and RTU. No I/O.

Written after the Modbus application protocol (V1.1b3) and the guides for TCP (V1.0b)
and serial line (V1.02), independent of the driver's library, so that the two may
disagree.
"""

from __future__ import annotations

import contextlib
import socket
import struct
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from truepath_simulators.links.links import PtyPort

ILLEGAL_FUNCTION = 1
ILLEGAL_ADDRESS = 2
ILLEGAL_VALUE = 3
GATEWAY_TARGET_SILENT = 11

READ_HOLDING = 3
WRITE_SINGLE = 6
WRITE_MULTIPLE = 16

_MAX_READ = 125
_MAX_WRITE = 123
_REQUEST = struct.Struct(">BHH")
_MBAP = struct.Struct(">HHHB")
_MAX_PDU = 253
_MAX_BUFFER = 4096


class ModbusError(Exception):
    """A request that is answered by an exception code."""

    def __init__(self, code: int) -> None:
        super().__init__(f"exception {code}")
        self.code = code


class Registers(ABC):
    """Holding registers behind a server. Both methods raise ModbusError."""

    @abstractmethod
    def read(self, address: int, count: int) -> list[int]:
        """One consistent snapshot."""

    @abstractmethod
    def write(self, address: int, values: list[int]) -> None:
        """All values take effect together."""


def answer(pdu: bytes, registers: Registers) -> bytes:
    """Answer to a request, without unit and without framing."""
    try:
        return _answer(pdu, registers)
    except ModbusError as error:
        return exception(pdu, error.code)


def exception(pdu: bytes, code: int) -> bytes:
    """An exception as the answer to a request."""
    return bytes([pdu[0] | 0x80, code])


def _answer(pdu: bytes, registers: Registers) -> bytes:
    function = pdu[0]
    if function not in (READ_HOLDING, WRITE_SINGLE, WRITE_MULTIPLE):
        raise ModbusError(ILLEGAL_FUNCTION)
    if len(pdu) < _REQUEST.size:
        raise ModbusError(ILLEGAL_VALUE)
    _, address, count = _REQUEST.unpack_from(pdu)
    if function == WRITE_SINGLE:
        registers.write(address, [count])
        return pdu[: _REQUEST.size]
    if function == WRITE_MULTIPLE:
        registers.write(address, _values(pdu, count))
        return pdu[: _REQUEST.size]
    if not 1 <= count <= _MAX_READ:
        raise ModbusError(ILLEGAL_VALUE)
    words = registers.read(address, count)
    return struct.pack(f">BB{count}H", function, 2 * count, *words)


def _values(pdu: bytes, count: int) -> list[int]:
    said, data = pdu[_REQUEST.size : _REQUEST.size + 1], pdu[_REQUEST.size + 1 :]
    fits = said == bytes([len(data) & 0xFF]) and len(data) == 2 * count
    if not 1 <= count <= _MAX_WRITE or not fits:
        raise ModbusError(ILLEGAL_VALUE)
    return list(struct.unpack(f">{count}H", data))


class TcpFramer:
    """Requests on one TCP connection: transaction, unit, PDU."""

    def __init__(self) -> None:
        self._buffer = b""

    def feed(self, data: bytes) -> list[tuple[int, int, bytes]] | None:
        """Requests that are complete now; None where the stream is not Modbus."""
        self._buffer += data
        requests: list[tuple[int, int, bytes]] = []
        while len(self._buffer) >= _MBAP.size + 1:
            transaction, protocol, length, unit = _MBAP.unpack_from(self._buffer)
            if protocol != 0 or not 2 <= length <= _MAX_PDU + 1:
                return None
            end = _MBAP.size - 1 + length
            if len(self._buffer) < end:
                break
            requests.append((transaction, unit, self._buffer[_MBAP.size : end]))
            self._buffer = self._buffer[end:]
        return requests


def tcp_frame(transaction: int, unit: int, pdu: bytes) -> bytes:
    return _MBAP.pack(transaction, 0, len(pdu) + 1, unit) + pdu


class RtuFramer:
    """Requests on a serial line: unit and PDU, cut by length and checked by CRC."""

    def __init__(self) -> None:
        self._buffer = b""

    def feed(self, data: bytes) -> list[tuple[int, bytes]]:
        """Requests that are complete now; bytes that fail the CRC are skipped."""
        self._buffer = (self._buffer + data)[-_MAX_BUFFER:]
        requests: list[tuple[int, bytes]] = []
        while len(self._buffer) >= 4:
            length = _rtu_length(self._buffer)
            if length > len(self._buffer):
                break
            frame = self._buffer[:length]
            if crc16(frame) == 0:
                requests.append((frame[0], frame[1:-2]))
                self._buffer = self._buffer[length:]
            else:
                self._buffer = self._buffer[1:]
        return requests

    def expire(self) -> None:
        """Discard an incomplete request after a silence of the line."""
        self._buffer = b""


def rtu_frame(unit: int, pdu: bytes) -> bytes:
    body = bytes([unit]) + pdu
    return body + struct.pack("<H", crc16(body))


def crc16(data: bytes) -> int:
    """CRC of Modbus RTU; 0 over a frame with its own CRC at the end."""
    crc = 0xFFFF
    for byte in data:
        crc = crc >> 8 ^ _CRC_TABLE[(crc ^ byte) & 0xFF]
    return crc


def _rtu_length(buffer: bytes) -> int:
    function = buffer[1]
    counted = {15: (6, 9), 16: (6, 9), 22: (None, 10), 23: (10, 13)}
    at, fixed = counted.get(function, (None, 8))
    if at is None:
        return fixed
    return fixed + buffer[at] if len(buffer) > at else fixed


def _crc_entry(value: int) -> int:
    for _ in range(8):
        value = value >> 1 ^ (0xA001 if value & 1 else 0)
    return value


_CRC_TABLE = tuple(_crc_entry(value) for value in range(256))


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
        host, port = self._listener.getsockname()[:2]
        return {"host": host, "port": port}

    def descriptors(self) -> list[int]:
        return [self._listener.fileno(), *(m.fileno() for m in self._masters)]

    def serve(self, answer: Answer) -> None:
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
        return {"serial_port": self._pty.address["port"]}

    def descriptors(self) -> list[int]:
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
