"""Driver of sensors behind Modbus, by a list of their registers."""

from __future__ import annotations

import logging
import math
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

from truepath_drivers import host_clock
from truepath_drivers.interfaces.errors import (
    ConnectionLost,
    DeviceError,
    DeviceTimeout,
    Refused,
)
from truepath_drivers.interfaces.records import Identity
from truepath_drivers.interfaces.thermometers import (
    STUCK_S,
    Channel,
    Reading,
    ReadingTry,
    Thermometers,
)
from truepath_drivers.transport.modbus_link import ModbusLink, make_address

log = logging.getLogger(__name__)

_NO_NUMBER = "the register holds no number"
_SMALL = 0.5  # words in the wrong order may look like less


class ModbusRegisters(Thermometers):
    """Sensors of a Modbus TCP gateway (`host`, `port`) or RTU line (`serial_port`).

    registers : the sensors, each a table of the keys of `Register`
    baudrate, parity : of the RTU line, `N`, `E` or `O`
    name : label of the group in a Run
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
        """One per row of the list."""
        return tuple(each.channel for each in self._registers)

    @property
    def period_s(self) -> float:
        """Period of the channel that is read most often."""
        return min(each.period_s for each in self._registers)

    def connect(self) -> Identity:
        """Open the link and read every sensor.

        A silent one is tried again later; DeviceTimeout if all are silent. Refused,
        naming the channel, where the device does not have its registers, and where only
        the other word order gives a plausible reading.
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
        self._is_connected = False
        self._link.close()

    def read(self) -> tuple[Reading, ...]:
        """Read the due channels. A silent unit is requested once per call."""
        if not self._is_connected:
            raise ConnectionLost(f"{self._link.name} is not connected; connect first")
        now_s = host_clock.now_s()
        due = [r for r in self._registers if now_s >= self._due_s.get(r.name, now_s)]
        silent: dict[int, str] = {}
        lost = self._reopen() if due else ""
        readings: list[Reading] = []
        for each in due:
            self._due_s[each.name] = now_s + each.period_s
            fault = lost or silent.get(each.unit, "")
            begin_s, value = host_clock.now_s(), math.nan
            if not fault:
                try:
                    value = self._read_value(each)
                    fault = _NO_NUMBER if math.isnan(value) else ""
                except ConnectionLost as error:
                    fault = lost = str(error)
                except DeviceTimeout as error:
                    fault = silent[each.unit] = str(error)
                except DeviceError as error:
                    fault = str(error)
            middle_s = 0.5 * (begin_s + host_clock.now_s())
            readings.append(Reading(each.name, middle_s, value, fault))
        return tuple(readings)

    def _require_answers(self) -> None:
        silent: dict[int, DeviceTimeout] = {}
        found: list[tuple[Register, float]] = []
        for each in self._registers:
            try:
                if each.unit not in silent:
                    found.append((each, self._read_value(each)))
            except DeviceTimeout as error:
                silent[each.unit] = error
                log.warning("%s", error)
            except Refused as error:
                raise Refused(f"{each.name}: {error}", error.code) from error
        if len(silent) == len({each.unit for each in self._registers}):
            raise next(iter(silent.values()))
        unresponsive: set[int] = set()  # units that bear no question beyond their list
        tried = [self._try_ways(each, value, unresponsive) for each, value in found]
        self.tries = tuple(one for ways in tried for one in ways)
        for (each, _), (own, other, *_) in zip(found, tried, strict=True):
            if each.count == 2 and other.is_likely:
                raise Refused(
                    f"{each.name}: its words are in the other order: {own.value} with "
                    f"{own.how}, {other.value} with {other.how}; set that"
                )

    def _try_ways(
        self, each: Register, value: float, unresponsive: set[int]
    ) -> list[ReadingTry]:
        ways, values = each.list_ways(), [value]
        for way in ways[1:]:
            values.append(math.nan)
            try:
                if way.unit not in unresponsive:
                    values[-1] = self._read_value(way)
            except Refused:
                pass
            except DeviceError:
                unresponsive.add(way.unit)
                self._reopen()
        # Its neighbour may be another sensor: its own address comes first.
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

    def _read_value(self, each: Register) -> float:
        words = self._link.read(
            each.address,
            each.count,
            unit=each.unit,
            are_inputs=each.function == "input",
        )
        return each.decode(words)

    def _reopen(self) -> str:
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


Kind = Literal["int16", "uint16", "int32", "uint32", "float32"]
Function = Literal["holding", "input"]
WordOrder = Literal["big", "little"]
_FORMS = {"int16": ">h", "uint16": ">H", "int32": ">i", "uint32": ">I", "float32": ">f"}
_HIGHEST = 0xFFFF
_LONGEST_PERIOD_S = 3600.0


@dataclass(frozen=True, slots=True)
class Register:
    """A row of the register list.

    name : as in `Channel`; unit : Modbus unit (device id)
    address : of the first word, counted from 0: 30001 and 40001 of a manual are 0
    word_order : of two words, `big` where the high word comes first
    scale, offset : the reading is offset + scale · the register
    period_s : between two readings
    low, high, stuck_s : as in `Channel`
    """

    name: str
    address: int
    unit: int = 1
    function: Function = "input"
    type: Kind = "int16"
    word_order: WordOrder = "big"
    scale: float = 1.0
    offset: float = 0.0
    period_s: float = 1.0
    low: float = math.nan
    high: float = math.nan
    stuck_s: float = STUCK_S

    def __post_init__(self) -> None:
        for key, known in (
            ("function", get_args(Function)),
            ("type", get_args(Kind)),
            ("word_order", get_args(WordOrder)),
        ):
            self._require(key, getattr(self, key) in known, " or ".join(known))
        last = _HIGHEST + 1 - self.count
        self._require("address", self.address in range(last + 1), f"0 to {last}")
        self._require("unit", self.unit in range(256), "0 to 255")
        is_scale = math.isfinite(self.scale) and self.scale != 0.0
        self._require("scale", is_scale, "a number that is not 0")
        self._require("offset", math.isfinite(self.offset), "a number")
        is_period = 0.0 < self.period_s <= _LONGEST_PERIOD_S
        self._require("period_s", is_period, f"above 0, to {_LONGEST_PERIOD_S:g}")
        self.channel  # noqa: B018, refuses name and limits

    @property
    def channel(self) -> Channel:
        """Name and limits for the service."""
        return Channel(self.name, self.low, self.high, self.stuck_s)

    @property
    def count(self) -> int:
        return struct.calcsize(_FORMS[self.type]) // 2

    def decode(self, words: Sequence[int]) -> float:
        """Reading of these words; NaN where they hold no number."""
        ordered = words if self.word_order == "big" else list(reversed(words))
        data = struct.pack(f">{len(ordered)}H", *ordered)
        value = struct.unpack(_FORMS[self.type], data)[0]
        if not math.isfinite(value):
            return math.nan
        # Rounded, so that 0 °C of an integer in kelvin is 0, not its rounding error.
        shown = self.offset + self.scale * value
        return shown if self.type == "float32" else round(shown, 9)

    def list_ways(self) -> list[Register]:
        """Ways to read it: this, the other order, neighbouring addresses."""
        other: WordOrder = "big" if self.word_order == "little" else "little"
        return [
            replace(self, address=address, word_order=order)
            for address in (self.address, self.address - 1, self.address + 1)
            if 0 <= address <= _HIGHEST + 1 - self.count
            for order in (self.word_order, other)[: self.count]
        ]

    def _require(self, key: str, kept: bool, otherwise: str) -> None:
        if not kept:
            raise ValueError(
                f"register {self.name!r}: {key} is {getattr(self, key)!r}, "
                f"expected {otherwise}"
            )
