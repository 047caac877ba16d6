"""Messages of GST/1 frames and their bytes, in both directions.

Measurements are handled in blocks by `codec`; here are the rare messages. A body is
`version u8 | type u8 | fields`, all little-endian, without padding; one that does not
fit is no message (docs/tracker-protocol.md).
"""

from __future__ import annotations

import struct
from dataclasses import astuple, dataclass
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
_LONGEST_TEXT = 60
# Messages of numbers alone, and the form of their fields in the record's order.
_NUMBERS: dict[int, tuple[type[Message], str]] = {
    Type.HELLO: (Hello, "<BB"),
    Type.STOP: (Stop, "<B"),
    Type.PING: (Ping, "<B"),
    Type.HOME: (Home, "<B"),
    Type.AIM: (Aim, "<Bdd"),
    Type.SEARCH: (Search, "<B"),
    Type.SET_AIR: (SetAir, "<Bddd"),
    Type.GET_AIR: (GetAir, "<B"),
    Type.STATUS: (Status, "<BQIII"),
    Type.EVENT: (Event, "<BQ"),
}
_FORMS = {kind: (number, form) for number, (kind, form) in _NUMBERS.items()}


def encode_message(message: Message) -> bytes:
    """Frame of a message, delimiters included."""
    match message:
        case Start(transaction, rate_hz, measured):
            kind, rate_mhz = Type.START, round(rate_hz * 1000)
            fields = struct.pack("<BIB", transaction, rate_mhz, measured)
        case Select(transaction, name):
            kind, fields = Type.SELECT, struct.pack("<B", transaction) + _text(name)
        case Ack(transaction, command, detail):
            kind = Type.ACK
            fields = struct.pack("<BB", transaction, command) + _detail(detail)
        case Nak(transaction, command, code, text):
            kind = Type.NAK
            fields = struct.pack("<BBB", transaction, command, code) + _text(text)
        case numbers:
            kind, form = _FORMS[type(numbers)]
            fields = struct.pack(form, *astuple(numbers))
    return encode_frame(_HEAD.pack(VERSION, kind) + fields)


def parse_message(body: bytes) -> Message | None:
    """Message of a body; None for a type or version that is not known here.

    Also None for a known type with a wrong length: half a message is worse than none.
    """
    if len(body) < _HEAD.size or body[0] != VERSION:
        return None
    try:
        return _parse(body[1], body[_HEAD.size :])
    except (struct.error, ValueError):
        return None


def _parse(kind: int, fields: bytes) -> Message | None:
    match kind:
        case Type.START:
            transaction, rate_mhz, measured = struct.unpack("<BIB", fields)
            return Start(transaction, rate_mhz / 1000, Format(measured))
        case Type.SELECT:
            (name,) = _split_texts(fields[1:], 1)
            return Select(fields[0], name)
        case Type.ACK:
            transaction, command = struct.unpack_from("<BB", fields)
            return Ack(transaction, command, _parse_detail(command, fields[2:]))
        case Type.NAK:
            transaction, command, code = struct.unpack_from("<BBB", fields)
            (text,) = _split_texts(fields[3:], 1)
            return Nak(transaction, command, code, text)
        case _ if kind in _NUMBERS:
            build, form = _NUMBERS[kind]
            return build(*struct.unpack(form, fields))
        case _:
            return None


def _detail(detail: Detail) -> bytes:
    match detail:
        case DeviceInfo(maker, model, serial_number, firmware, max_rate_hz, version):
            texts = (maker, model, serial_number, firmware)
            numbers = struct.pack("<BI", version, round(max_rate_hz * 1000))
            return numbers + b"".join(map(_text, texts))
        case StreamInfo(rate_hz, sequence, clock):
            return struct.pack("<IHQ", round(rate_hz * 1000), sequence, clock)
        case AirInUse(temperature, pressure, humidity):
            return struct.pack("<ddd", temperature, pressure, humidity)
        case None:
            return b""


def _parse_detail(command: int, fields: bytes) -> Detail:
    match command:
        case Type.HELLO:
            version, rate_mhz = struct.unpack_from("<BI", fields)
            texts = _split_texts(fields[5:], 4)
            return DeviceInfo(*texts, max_rate_hz=rate_mhz / 1000, version=version)
        case Type.START:
            rate_mhz, sequence, clock = struct.unpack("<IHQ", fields)
            return StreamInfo(rate_mhz / 1000, sequence, clock)
        case Type.SET_AIR | Type.GET_AIR:
            return AirInUse(*struct.unpack("<ddd", fields))
        case _:
            return None


def _text(text: str) -> bytes:
    coded = text.encode()[:_LONGEST_TEXT].decode(errors="ignore").encode()
    return bytes([len(coded)]) + coded


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
