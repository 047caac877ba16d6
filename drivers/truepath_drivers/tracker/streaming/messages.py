"""Messages of GST/1 frames, in both directions (docs/tracker-protocol.md).

Measurements are handled in blocks by `measurements`; here are the rare messages. Their
bytes are in `message_codec`.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

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
    """State in a STATUS frame."""

    IDLE = 0
    STREAMING = 1
    FAULT = 2


class EventCode(IntEnum):
    """Kind of an EVENT frame."""

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
