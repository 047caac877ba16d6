"""Messages of GST/1 frames and their bytes, in both directions.

Measurements are handled in blocks by `codec`; here are the rare messages. A body is
`version u8 | type u8 | fields`, all little-endian, without padding; one that does not
fit is no message (docs/tracker-protocol.md).
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum

from truepath_drivers.tracker.streaming.framing import encode_frame

VERSION = 1
VERBS_VERSION = 2  # a HELLO of it makes HOME to GET_AIR known; frames stay as they are


class Type(IntEnum):
    """Second byte of a body."""

    MEAS = 0x10
    STATUS = 0x12
    EVENT = 0x13
    MEAS64 = 0x14
    HELLO = 0x20
    START = 0x21
    STOP = 0x22
    PING = 0x23
    HOME = 0x24
    AIM = 0x25
    SEARCH = 0x26
    SELECT = 0x27
    SET_AIR = 0x28
    GET_AIR = 0x29
    ACK = 0x30
    NAK = 0x31


class Format(IntEnum):
    """Measurement frame that a START requests."""

    MEAS64 = 0
    MEAS = 1


class NakCode(IntEnum):
    """Why a device refuses a command."""

    UNKNOWN_COMMAND = 1
    BAD_ARGUMENT = 2
    RATE_NOT_POSSIBLE = 3
    BUSY = 4
    NOT_READY = 5
    VERSION_NOT_SPOKEN = 6
    NO_TARGET = 7


class DeviceState(IntEnum):
    IDLE = 0
    STREAMING = 1
    FAULT = 2


class EventCode(IntEnum):
    BEAM_BROKEN = 1
    BEAM_LOCKED = 2
    STREAM_STOPPED_NO_PING = 3
    TRIGGER = 4


@dataclass(frozen=True, slots=True)
class Hello:
    """Host requests the identity; starts and stops nothing."""

    transaction: int
    host_version: int = VERSION


@dataclass(frozen=True, slots=True)
class Start:
    """Host requests a stream; no change if it streams so already."""

    transaction: int
    rate_hz: float
    format: Format = Format.MEAS64


@dataclass(frozen=True, slots=True)
class Stop:
    """Host ends the stream. No measurement follows its ACK."""

    transaction: int


@dataclass(frozen=True, slots=True)
class Ping:
    """Host is alive. The device stops a stream 5 s after the last one."""

    transaction: int


@dataclass(frozen=True, slots=True)
class Home:
    """Host sends the beam to the instrument's own reference, to initialise there."""

    transaction: int


@dataclass(frozen=True, slots=True)
class Aim:
    """Host points the beam in the tracker's frame."""

    transaction: int
    azimuth_rad: float
    elevation_rad: float


@dataclass(frozen=True, slots=True)
class Search:
    """Host has the device find and lock a target near the beam."""

    transaction: int


@dataclass(frozen=True, slots=True)
class Select:
    """Host names the target to lock and to measure from now on."""

    transaction: int
    name: str


@dataclass(frozen=True, slots=True)
class SetAir:
    """Host sets the air for the refraction; NaN where it is not known."""

    transaction: int
    temperature_degc: float
    pressure_hpa: float
    humidity_percent: float


@dataclass(frozen=True, slots=True)
class GetAir:
    """Host requests the air in use."""

    transaction: int


@dataclass(frozen=True, slots=True)
class AirInUse:
    """Detail of the ACK of a SET_AIR and of a GET_AIR."""

    temperature_degc: float
    pressure_hpa: float
    humidity_percent: float


@dataclass(frozen=True, slots=True)
class DeviceInfo:
    """Detail of the ACK of a HELLO. Texts of at most 60 bytes of UTF-8."""

    maker: str
    model: str
    serial_number: str
    firmware: str
    max_rate_hz: float
    version: int = VERSION


@dataclass(frozen=True, slots=True)
class StreamInfo:
    """Detail of the ACK of a START: rate, number of the next sample, device clock."""

    rate_hz: float
    next_sequence: int
    clock_us: int


Detail = DeviceInfo | StreamInfo | AirInUse | None


@dataclass(frozen=True, slots=True)
class Ack:
    """Device has executed the command of this transaction."""

    transaction: int
    command: int
    detail: Detail = None


@dataclass(frozen=True, slots=True)
class Nak:
    """Device refuses the command of this transaction."""

    transaction: int
    command: int
    code: int
    text: str = ""


@dataclass(frozen=True, slots=True)
class Status:
    """Device health, twice per second."""

    state: int
    clock_us: int
    frames_sent: int
    frames_dropped: int
    buffer_high_water_bytes: int


@dataclass(frozen=True, slots=True)
class Event:
    """An event at the device, by its own clock."""

    code: int
    clock_us: int


Verb = Home | Aim | Search | Select | SetAir | GetAir
Command = Hello | Start | Stop | Ping | Verb
Reply = Ack | Nak
Message = Command | Reply | Status | Event


_HEAD = struct.Struct("<BB")
_HELLO = struct.Struct("<BB")
_START = struct.Struct("<BIB")
_TRANSACTION = struct.Struct("<B")
_REPLY = struct.Struct("<BB")
_CODE = struct.Struct("<B")
_INFO = struct.Struct("<BI")
_STREAM = struct.Struct("<IHQ")
_STATUS = struct.Struct("<BQIII")
_EVENT = struct.Struct("<BQ")
_AIM = struct.Struct("<Bdd")
_SET_AIR = struct.Struct("<Bddd")
_AIR = struct.Struct("<ddd")

_LONGEST_TEXT = 60


def encode_message(message: Message) -> bytes:
    """Frame of a message, delimiters included."""
    kind, fields = _fields(message)
    return encode_frame(_HEAD.pack(VERSION, kind) + fields)


def parse_message(body: bytes) -> Message | None:
    """Message of a body; None for a type or version that is not known here.

    Also None for a known type with a wrong length: half a message is worse than none.
    """
    if len(body) < _HEAD.size or body[0] != VERSION:
        return None
    parse = _PARSERS.get(body[1])
    try:
        return parse(body[_HEAD.size :]) if parse else None
    except (struct.error, ValueError):
        return None


def _fields(message: Message) -> tuple[Type, bytes]:
    match message:
        case Hello(transaction, version):
            return Type.HELLO, _HELLO.pack(transaction, version)
        case Start(transaction, rate_hz, measured):
            rate_mhz = round(rate_hz * 1000)
            return Type.START, _START.pack(transaction, rate_mhz, measured)
        case Aim(transaction, azimuth_rad, elevation_rad):
            return Type.AIM, _AIM.pack(transaction, azimuth_rad, elevation_rad)
        case Select(transaction, name):
            return Type.SELECT, _TRANSACTION.pack(transaction) + _text(name)
        case SetAir(transaction, temperature, pressure, humidity):
            values = temperature, pressure, humidity
            return Type.SET_AIR, _SET_AIR.pack(transaction, *values)
        case Ack(transaction, command, detail):
            return Type.ACK, _REPLY.pack(transaction, command) + _detail(detail)
        case Nak(transaction, command, code, text):
            head = _REPLY.pack(transaction, command)
            return Type.NAK, head + _CODE.pack(code) + _text(text)
        case Status(state, clock, sent, dropped, high_water):
            return Type.STATUS, _STATUS.pack(state, clock, sent, dropped, high_water)
        case Event(code, clock):
            return Type.EVENT, _EVENT.pack(code, clock)
        case plain:
            return _PLAIN[type(plain)], _TRANSACTION.pack(plain.transaction)


def _detail(detail: Detail) -> bytes:
    match detail:
        case DeviceInfo(maker, model, serial_number, firmware, max_rate_hz, version):
            texts = (maker, model, serial_number, firmware)
            numbers = _INFO.pack(version, round(max_rate_hz * 1000))
            return numbers + b"".join(map(_text, texts))
        case StreamInfo(rate_hz, sequence, clock):
            return _STREAM.pack(round(rate_hz * 1000), sequence, clock)
        case AirInUse(temperature, pressure, humidity):
            return _AIR.pack(temperature, pressure, humidity)
        case None:
            return b""


def _text(text: str) -> bytes:
    coded = text.encode()[:_LONGEST_TEXT].decode(errors="ignore").encode()
    return bytes([len(coded)]) + coded


def _parse_start(fields: bytes) -> Start:
    transaction, rate_mhz, measured = _START.unpack(fields)
    return Start(transaction, rate_mhz / 1000, Format(measured))


def _parse_ack(fields: bytes) -> Ack:
    transaction, command = _REPLY.unpack_from(fields)
    rest = fields[_REPLY.size :]
    detail: Detail = None
    if command == Type.HELLO:
        detail = _parse_info(rest)
    elif command == Type.START:
        rate_mhz, sequence, clock = _STREAM.unpack(rest)
        detail = StreamInfo(rate_mhz / 1000, sequence, clock)
    elif command in (Type.SET_AIR, Type.GET_AIR):
        detail = AirInUse(*_AIR.unpack(rest))
    return Ack(transaction, command, detail)


def _parse_info(fields: bytes) -> DeviceInfo:
    version, rate_mhz = _INFO.unpack_from(fields)
    maker, model, serial_number, firmware = _split_texts(fields[_INFO.size :], 4)
    return DeviceInfo(maker, model, serial_number, firmware, rate_mhz / 1000, version)


def _parse_nak(fields: bytes) -> Nak:
    transaction, command = _REPLY.unpack_from(fields)
    (code,) = _CODE.unpack_from(fields, _REPLY.size)
    (text,) = _split_texts(fields[_REPLY.size + _CODE.size :], 1)
    return Nak(transaction, command, code, text)


def _parse_select(fields: bytes) -> Select:
    (name,) = _split_texts(fields[1:], 1)
    return Select(fields[0], name)


def _split_texts(fields: bytes, count: int) -> list[str]:
    texts: list[str] = []
    for _ in range(count):
        if not fields or len(fields) <= fields[0]:
            raise ValueError("a text ends before its length")
        texts.append(fields[1 : 1 + fields[0]].decode())
        fields = fields[1 + fields[0] :]
    if fields:
        raise ValueError("bytes after the last text")
    return texts


_PLAIN: dict[type[Stop | Ping | Home | Search | GetAir], Type] = {
    Stop: Type.STOP,
    Ping: Type.PING,
    Home: Type.HOME,
    Search: Type.SEARCH,
    GetAir: Type.GET_AIR,
}
_PARSERS: dict[int, Callable[[bytes], Message]] = {
    Type.HELLO: lambda fields: Hello(*_HELLO.unpack(fields)),
    Type.START: _parse_start,
    Type.STOP: lambda fields: Stop(*_TRANSACTION.unpack(fields)),
    Type.PING: lambda fields: Ping(*_TRANSACTION.unpack(fields)),
    Type.HOME: lambda fields: Home(*_TRANSACTION.unpack(fields)),
    Type.AIM: lambda fields: Aim(*_AIM.unpack(fields)),
    Type.SEARCH: lambda fields: Search(*_TRANSACTION.unpack(fields)),
    Type.SELECT: _parse_select,
    Type.SET_AIR: lambda fields: SetAir(*_SET_AIR.unpack(fields)),
    Type.GET_AIR: lambda fields: GetAir(*_TRANSACTION.unpack(fields)),
    Type.ACK: _parse_ack,
    Type.NAK: _parse_nak,
    Type.STATUS: lambda fields: Status(*_STATUS.unpack(fields)),
    Type.EVENT: lambda fields: Event(*_EVENT.unpack(fields)),
}
