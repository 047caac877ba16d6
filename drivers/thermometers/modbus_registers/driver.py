"""The driver of sensors behind Modbus, by a list of their registers."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Mapping, Sequence
from typing import Any

from truepath.drivers.interfaces.errors import (
    ConnectionLost,
    DeviceError,
    DeviceTimeout,
    Refused,
)
from truepath.drivers.interfaces.records import Identity
from truepath.drivers.interfaces.thermometers import (
    Channel,
    Reading,
    ReadingTry,
    Thermometers,
)
from truepath.drivers.thermometers.modbus_registers.register import Register
from truepath.drivers.transport.modbus_link import ModbusLink, make_address

log = logging.getLogger(__name__)

_NO_NUMBER = "the register holds no number"
_SMALL = 0.5  # words in the wrong order may look like less


class ModbusRegisters(Thermometers):
    """Sensors of one Modbus TCP gateway (`host`, `port`) or RTU line (`serial_port`).

    registers : the sensors, each a table of the keys of `Register`
    baudrate, parity : of the RTU line, `N`, `E` or `O`
    name : what a Run calls the group
    """

    def __init__(
        self,
        *,
        registers: Sequence[Mapping[str, Any]],
        host: str | None = None,
        port: int = 502,
        serial_port: str | None = None,
        baudrate: int = 19_200,
        parity: str = "N",
        name: str = "Modbus registers",
    ) -> None:
        self._registers = [_read_register(each) for each in registers]
        names = [each.name for each in self._registers]
        if not names or len(set(names)) < len(names):
            raise ValueError("registers: expected one or more, each name once")
        address = make_address(host, port, serial_port, baudrate, parity)
        self._link = ModbusLink(address, self._registers[0].unit)
        self._identity = Identity("", name, "", "")
        self._due_s: dict[str, float] = {}
        self._is_connected = False

    @property
    def channels(self) -> tuple[Channel, ...]:
        """One a row of the list."""
        return tuple(each.channel for each in self._registers)

    @property
    def period_s(self) -> float:
        """Period of the channel that is read most often."""
        return min(each.period_s for each in self._registers)

    def connect(self) -> Identity:
        """Open the link and read every sensor.

        One that is silent is left for later; DeviceTimeout if all are. Refused, naming
        the channel, where the device does not have its registers, and where its words
        are a reading in the other order alone.
        """
        if self._is_connected and self._link.is_open:
            return self._identity
        self._link.open()
        try:
            self._require_answers()
        except DeviceError:
            self._link.close()
            raise
        self._due_s, self._is_connected = {}, True
        return self._identity

    def close(self) -> None:
        """Release the port."""
        self._is_connected = False
        self._link.close()

    def read(self) -> tuple[Reading, ...]:
        """Read what is due. A unit that is silent is asked once in a call."""
        if not self._is_connected:
            raise ConnectionLost(f"{self._link.name} is not connected; connect first")
        now_s = time.monotonic()
        due = [r for r in self._registers if now_s >= self._due_s.get(r.name, now_s)]
        silent: dict[int, str] = {}
        lost = self._open_anew() if due else ""
        readings: list[Reading] = []
        for each in due:
            self._due_s[each.name] = now_s + each.period_s
            fault = lost or silent.get(each.unit, "")
            begin_s, value = time.monotonic(), math.nan
            if not fault:
                try:
                    value = self._ask(each)
                    fault = _NO_NUMBER if math.isnan(value) else ""
                except ConnectionLost as error:
                    fault = lost = str(error)
                except DeviceTimeout as error:
                    fault = silent[each.unit] = str(error)
                except DeviceError as error:
                    fault = str(error)
            middle_s = 0.5 * (begin_s + time.monotonic())
            readings.append(Reading(each.name, middle_s, value, fault))
        return tuple(readings)

    def _require_answers(self) -> None:
        silent: dict[int, DeviceTimeout] = {}
        found: list[tuple[Register, float]] = []
        for each in self._registers:
            try:
                if each.unit not in silent:
                    found.append((each, self._ask(each)))
            except DeviceTimeout as error:
                silent[each.unit] = error
                log.warning("%s", error)
            except Refused as error:
                raise Refused(f"{each.name}: {error}", error.code) from error
        if len(silent) == len({each.unit for each in self._registers}):
            raise next(iter(silent.values()))
        shy: set[int] = set()  # units that bear no question beyond their list
        tried = [self._try_ways(each, value, shy) for each, value in found]
        self.tries = tuple(one for ways in tried for one in ways)
        for (each, _), (own, other, *_) in zip(found, tried, strict=True):
            if each.count == 2 and other.is_likely:
                raise Refused(
                    f"{each.name}: its words are in the other order: {own.value} with "
                    f"{own.how}, {other.value} with {other.how}; set that"
                )

    def _try_ways(
        self, each: Register, value: float, shy: set[int]
    ) -> list[ReadingTry]:
        """Read a sensor in every way; `value` is what it shows in that of the list."""
        ways, values = each.list_ways(), [value]
        for way in ways[1:]:
            values.append(math.nan)
            try:
                if way.unit not in shy:
                    values[-1] = self._ask(way)
            except Refused:
                pass
            except DeviceError:
                shy.add(way.unit)
                self._open_anew()
        # Beside it another sensor may be: its own address comes first.
        fault = each.channel.find_fault
        may = [i for i, v in enumerate(values) if v != 0.0 and not fault(v)]
        own = [i for i in may if i < each.count] or may
        likely = next((i for i in own if abs(values[i]) > _SMALL), (*own, -1)[0])
        return [
            ReadingTry(
                each.name,
                f"address = {way.address}"
                + f', word_order = "{way.word_order}"' * (each.count > 1),
                values[i] if math.isfinite(values[i]) else None,
                is_set=i == 0,
                is_likely=i == likely,
            )
            for i, way in enumerate(ways)
        ]

    def _ask(self, each: Register) -> float:
        words = self._link.read(
            each.address,
            each.count,
            unit=each.unit,
            are_inputs=each.function == "input",
        )
        return each.decode(words)

    def _open_anew(self) -> str:
        """Open a link that was lost; return why it cannot be."""
        if self._link.is_open:
            return ""
        try:
            self._link.open()
        except ConnectionLost as error:
            return str(error)
        return ""


def _read_register(stated: Mapping[str, Any]) -> Register:
    try:
        return Register(**stated)
    except TypeError as error:
        raise ValueError(f"registers: {dict(stated)}: {error}") from error
