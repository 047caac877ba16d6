"""Requests to one Modbus unit, bounded in time, with failures by family."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass

from pymodbus.client import ModbusSerialClient, ModbusTcpClient
from pymodbus.exceptions import ConnectionException, ModbusException
from pymodbus.pdu import ModbusPDU

from truepath_drivers.interfaces.errors import (
    ConnectionLost,
    DeviceBusy,
    DeviceError,
    DeviceTimeout,
    MotionFault,
    Refused,
)

# Our errors carry the cause; without this the library's log goes to the terminal.
logging.getLogger("pymodbus.logging").addHandler(logging.NullHandler())

# The library's own 3 s and 3 repeats are 12 s of blindness. The caller repeats what may
# be repeated, unless a hold is waiting.
TIMEOUT_S = 0.2
RETRIES = 0

_CONFIGURATION = {
    1: "does not know this function",
    2: "does not have these registers",
    3: "does not take this value",
}
_WAIT = (5, 6)
_GATEWAY = (10, 11)


@dataclass(frozen=True, slots=True)
class TcpAddress:
    host: str
    port: int

    def __str__(self) -> str:
        return f"{self.host}:{self.port}"

    def client(self) -> ModbusTcpClient:
        return ModbusTcpClient(
            self.host, port=self.port, timeout=TIMEOUT_S, retries=RETRIES
        )


@dataclass(frozen=True, slots=True)
class SerialAddress:
    """A Modbus RTU line of 8 bits; parity `N`, `E` or `O`."""

    path: str
    baudrate: int
    parity: str = "N"

    def __str__(self) -> str:
        return self.path

    def client(self) -> ModbusSerialClient:
        return ModbusSerialClient(
            self.path,
            baudrate=self.baudrate,
            parity=self.parity,
            timeout=TIMEOUT_S,
            retries=RETRIES,
        )


def make_address(
    host: str | None,
    port: int,
    serial_port: str | None,
    baudrate: int,
    parity: str = "N",
) -> TcpAddress | SerialAddress:
    """Address of the options. Raises ValueError unless they name exactly one."""
    if (host is None) == (serial_port is None):
        raise ValueError("give either host (Modbus TCP) or serial_port (Modbus RTU)")
    if parity not in ("N", "E", "O"):
        raise ValueError(f"parity {parity!r} is none of N, E, O")
    if host is not None:
        return TcpAddress(host, port)
    return SerialAddress(str(serial_port), baudrate, parity)


class ModbusLink:
    """Registers of units on one line. For one thread at a time: drivers lock.

    unit : default unit of requests

    A connection that broke stays broken until `open`: the library would reopen it
    automatically, and another device may answer by then. A connection that is only
    silent is kept: what was sent on it would otherwise be obeyed after what is sent on
    the next one.
    """

    def __init__(self, address: TcpAddress | SerialAddress, unit: int) -> None:
        self._address = address
        self._unit = unit
        self._client: ModbusTcpClient | ModbusSerialClient | None = None

    @property
    def name(self) -> str:
        return f"{self._address} unit {self._unit}"

    @property
    def is_open(self) -> bool:
        return self._client is not None and self._client.connected

    def open(self) -> None:
        """Reconnect. Raises ConnectionLost."""
        self.close()
        client = self._address.client()
        if not client.connect():
            raise ConnectionLost(
                f"{self._address} cannot be opened; check address, cable and power, "
                "and that no other program uses the port"
            )
        self._client = client

    def close(self) -> None:
        client, self._client = self._client, None
        if client is not None:
            client.close()

    def read(
        self,
        address: int,
        count: int,
        *,
        unit: int | None = None,
        are_inputs: bool = False,
    ) -> list[int]:
        """Read holding or input registers. Harmless, so it may be repeated."""
        client = self._require_connected()
        read = (
            client.read_input_registers if are_inputs else client.read_holding_registers
        )
        asked = self._unit if unit is None else unit
        try:
            reply = read(address, count=count, device_id=asked)
        except (ModbusException, OSError) as error:
            raise self._failure(error, asked) from error
        self._check(reply, asked, f"reading {count} registers at {address}")
        if len(reply.registers) != count:
            raise DeviceTimeout(
                f"{self._address} unit {asked}: {len(reply.registers)} registers came, "
                f"not {count}; the reply is not to this request"
            )
        return list(reply.registers)

    def write(self, address: int, words: Sequence[int]) -> None:
        """Write registers in one request. DeviceTimeout leaves the outcome unknown."""
        client = self._require_connected()
        try:
            reply = client.write_registers(address, list(words), device_id=self._unit)
        except (ModbusException, OSError) as error:
            raise self._failure(error, self._unit) from error
        self._check(reply, self._unit, f"writing {len(words)} registers at {address}")

    def _require_connected(self) -> ModbusTcpClient | ModbusSerialClient:
        if self._client is None or not self._client.connected:
            raise ConnectionLost(f"{self._address} is not connected; connect first")
        return self._client

    def _failure(self, error: Exception, unit: int) -> DeviceError:
        if isinstance(error, ConnectionException | OSError):
            self.close()
            return ConnectionLost(
                f"{self._address} is gone; check cable and power, then connect again"
            )
        return DeviceTimeout(
            f"{self._address} unit {unit}: no valid reply in {TIMEOUT_S:g} s; check "
            "power, unit number, baud rate and shielding"
        )

    def _check(self, reply: ModbusPDU, unit: int, doing: str) -> None:
        if not reply.isError():
            return
        code = reply.exception_code
        place = f"{self._address} unit {unit}, {doing}"
        if code in _CONFIGURATION:
            raise Refused(
                f"{place}: the device {_CONFIGURATION[code]} (exception {code}); "
                "check unit number and register map",
                code,
            )
        if code in _WAIT:
            raise DeviceBusy(f"{place}: the device is busy (exception {code})")
        if code in _GATEWAY:
            raise ConnectionLost(
                f"{place}: the gateway does not reach the device (exception {code}); "
                "check the line behind it"
            )
        raise MotionFault(f"{place}: the device has failed (exception {code})")
