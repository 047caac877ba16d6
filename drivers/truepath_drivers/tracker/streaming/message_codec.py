"""Bodies of GST/1 frames as bytes, in both directions (docs/tracker-protocol.md).

A body is `version u8 | type u8 | fields`, all little-endian, without padding. A body
that does not fit is no message.
"""

from __future__ import annotations

import struct
from collections.abc import Callable

from truepath_drivers.tracker.streaming.framing import encode_frame
from truepath_drivers.tracker.streaming.messages import (
    VERSION,
    Ack,
    Aim,
    AirInUse,
    Detail,
    DeviceInfo,
    Event,
    Format,
    GetAir,
    Hello,
    Home,
    Message,
    Nak,
    Ping,
    Search,
    Select,
    SetAir,
    Start,
    Status,
    Stop,
    StreamInfo,
    Type,
)

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
