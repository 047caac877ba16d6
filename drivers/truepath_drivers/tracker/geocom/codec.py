"""GeoCOM in ASCII: requests, replies, and the return codes of measurements.

    %R1Q,<procedure>,<transaction>:<parameters>CRLF
    %R1P,<code of the link>,<transaction>:<code of the procedure>,<values>CRLF

Names and numbers are those of geocompy 1.0.0 (`geocompy.geo`), units those of DMPACK's
manual where it gives them.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

TRANSACTIONS = 1 << 15  # then numbers begin again
_TURN_RAD = 6.2832
_DIGITS = 15  # more than six are cut by the format: so do public clients
_VALUE = re.compile(rb'(?:"[^"]*"|[^,])*')
_REPLY = re.compile(rb"^%R1P,(\d+)(?:,(\d+))?(?:,\d+)?:(\d+)(?:,(.*))?$")


class Procedure(IntEnum):
    TMC_DO_MEASURE = 2008
    TMC_GET_PRISM_CORRECTION = 2023
    TMC_SET_PRISM_CORRECTION = 2024
    TMC_SET_ATMOSPHERE = 2028
    TMC_GET_ATMOSPHERE = 2029
    TMC_GET_SIMPLE_MEASUREMENT = 2108
    CSV_GET_SERIAL_NUMBER = 5003
    CSV_GET_INSTRUMENT_NAME = 5004
    CSV_GET_FIRMWARE_VERSION = 5034
    AUT_LOCK_IN = 9013
    AUT_SET_ATR = 9018
    AUT_SET_LOCK = 9020
    AUT_TURN_TO = 9027
    AUT_SEARCH = 9029
    AUS_SET_USER_ATR = 18005
    AUS_SET_USER_LOCK = 18007


class ReturnCode(IntEnum):
    """Codes that are handled here."""

    OK = 0
    NOT_IMPLEMENTED = 5
    ABORT = 8
    NO_FULL_CORRECTION = 1283
    ACCURACY_NOT_GUARANTEED = 1284
    ANGLE_ONLY = 1285
    ANGLE_NO_FULL_CORRECTION = 1288
    ANGLE_NO_ACCURACY = 1289
    ANGLE_ERROR = 1290
    WRONG_DISTANCE_MODE = 1291
    DISTANCE_ERROR = 1292
    BUSY = 1293
    SIGNAL_ERROR = 1294
    PROCEDURE_UNKNOWN = 3081
    AUT_TIMEOUT = 8704
    AUT_NO_TARGET = 8710
    AUT_MULTIPLE_TARGETS = 8711
    AUT_BAD_ENVIRONMENT = 8712
    AUT_NOT_ENABLED = 8714
    AUT_NO_LOCK = 8725


C = ReturnCode
NOT_OFFERED = frozenset({C.NOT_IMPLEMENTED, C.PROCEDURE_UNKNOWN})
WITH_A_WARNING = frozenset({C.NO_FULL_CORRECTION, C.ACCURACY_NOT_GUARANTEED})
NO_TARGET = frozenset(
    {
        C.ANGLE_ONLY,
        C.ANGLE_NO_FULL_CORRECTION,
        C.ANGLE_NO_ACCURACY,
        C.DISTANCE_ERROR,
        C.SIGNAL_ERROR,
        C.AUT_NO_TARGET,
        C.AUT_MULTIPLE_TARGETS,
        C.AUT_BAD_ENVIRONMENT,
        C.AUT_NO_LOCK,
    }
)


@dataclass(frozen=True, slots=True)
class Reply:
    """A reply; `transaction` is None where it has none."""

    link_code: int
    transaction: int | None
    code: int
    values: tuple[bytes, ...]


def encode_request(
    procedure: int, transaction: int, values: tuple[int | float, ...] = ()
) -> bytes:
    """Request without its end of line."""
    text = ",".join(map(_encode_value, values))
    return f"%R1Q,{int(procedure)},{transaction}:{text}".encode("ascii")


def parse_reply(line: bytes) -> Reply | None:
    """The reply in a line, None where there is none."""
    found = _REPLY.match(line.strip())
    if found is None:
        return None
    link, transaction, code, values = found.groups()
    return Reply(
        int(link),
        None if transaction is None else int(transaction),
        int(code),
        () if values is None else _split(values),
    )


def describe_code(code: int) -> str:
    """Text of a return code, with its number."""
    try:
        return f"{ReturnCode(code).name.lower().replace('_', ' ')} ({code})"
    except ValueError:
        return f"return code {code}"


def to_cartesian_mm(
    hz_rad: float, v_rad: float, slope_distance_m: float
) -> NDArray[np.float64]:
    """(x, y, z): x where Hz is a right angle, y where it is 0, z upwards.

    Hz turns clockwise seen from above, V is the angle from the zenith: right-handed.
    """
    level = np.sin(v_rad)
    way = [level * np.sin(hz_rad), level * np.cos(hz_rad), np.cos(v_rad)]
    return 1e3 * slope_distance_m * np.array(way)


def is_point(hz_rad: float, v_rad: float, slope_distance_m: float) -> bool:
    """Whether these are a point: angles within a turn, so not in deg or gon."""
    angles = abs(hz_rad) <= _TURN_RAD and abs(v_rad) <= _TURN_RAD
    return angles and 0.0 < slope_distance_m < np.inf


def _split(values: bytes) -> tuple[bytes, ...]:
    """A comma in quotes is part of its text."""
    found, end = [], -1
    while end < len(values):
        value = _VALUE.match(values, end + 1)
        assert value is not None  # noqa: S101 (it matches nothing as well)
        found.append(value.group())
        end = value.end()
    return tuple(found)


def _encode_value(value: int | float) -> str:
    if isinstance(value, int):
        return f"{int(value)}"
    text = f"{round(value, _DIGITS):f}".rstrip("0")
    return text + "0" if text.endswith(".") else text
