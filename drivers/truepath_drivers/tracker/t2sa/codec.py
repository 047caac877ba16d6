"""Lines of T2SA: `ACK-300 text` or `ERR-305 text`, and the points in them.

Commands, replies and error numbers are those of ts_lasertracker (`t2sa_model.py`,
`utils.py`, `enums.py`, `mock_t2sa.py`). A reply names no request.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

_REPLY = re.compile(rb"^(ACK|ERR)-(\d{3})\s+(.*)$")
_POINT = re.compile(
    r"^Single Point Measurement (?P<name>.*) result "
    r"(?P<x>[^,]+),(?P<y>[^,]+),(?P<z>[^, ]+)(?: .*)?$"
)
_FRAME = re.compile(
    r"^Object Offset Report (?P<name>[^;]*);"
    r"X:(?P<x>[^;]+);Y:(?P<y>[^;]+);Z:(?P<z>[^;]+);"
)
CONNECTED = "Instrument is connected"
LASER_ON, LASER_OFF = "LON", "LOFF"


class ErrorCode(IntEnum):
    """Error numbers that are handled here."""

    REJECTED = 200
    BUSY = 201
    POINT_FAILED = 305
    HALTED = 330
    NOT_READY = 338
    GROUP_FAILED = 340
    NO_LOCK = 342
    NO_BEAM_LOCK = 343


NO_TARGET = frozenset(
    {
        ErrorCode.POINT_FAILED,
        ErrorCode.GROUP_FAILED,
        ErrorCode.NO_LOCK,
        ErrorCode.NO_BEAM_LOCK,
    }
)


@dataclass(frozen=True, slots=True)
class Reply:
    """One line of the application."""

    is_good: bool
    code: int
    text: str


def parse_reply(line: bytes) -> Reply | None:
    """The reply in a line, None where there is none."""
    found = _REPLY.match(line.strip())
    if found is None:
        return None
    kind, code, text = found.groups()
    return Reply(kind == b"ACK", int(code), text.decode("utf-8", "replace"))


def parse_place(text: str, name: str) -> NDArray[np.float64] | None:
    """Point of that name, or frame with it in its name, (3,); else None."""
    point, frame = _POINT.match(text), _FRAME.match(text)
    found = point if point is not None and point["name"] == name else None
    if frame is not None and name in frame["name"]:
        found = frame
    if found is None:
        return None
    try:
        place = np.array([float(found[axis]) for axis in "xyz"])
    except ValueError:
        return None
    # The tracker sees nothing at its own centre: zeros are a point that failed.
    return place if np.isfinite(place).all() and place.any() else None
