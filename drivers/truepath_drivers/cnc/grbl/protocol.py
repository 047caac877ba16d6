"""The words of GRBL 1.1: reports, settings, alarms, characters that act at once.

Source: GRBL's own interface, commands and code lists (github.com/gnea/grbl, doc).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truepath_drivers.interfaces.errors import ConnectionLost

HOLD, RESUME, ASK, RESET = b"!", b"~", b"?", b"\x18"
FULL_FEED, TEN_LESS, ONE_LESS = b"\x90", b"\x92", b"\x94"
AXES = ("X", "Y", "Z")
ALARMS: Mapping[int, str] = {
    1: "a limit switch was hit; the position is likely lost",
    2: "the target is beyond the soft limits",
    3: "reset in motion; the position is likely lost",
    4: "the probe was not in its first state",
    5: "the probe met nothing",
    6: "homing was reset",
    7: "a door was opened during homing",
    8: "homing did not get off the switch",
    9: "homing found no switch",
    10: "homing found no second switch of an axis",
}
ERRORS: Mapping[int, str] = {
    2: "a number is damaged",
    3: "an unknown setting or command",
    5: "homing is not enabled ($22=0)",
    8: "not while it runs or holds",
    9: "locked by an alarm",
    11: "the line is too long",
    13: "a door is open",
    20: "an unknown G-code",
    22: "no feed is set",
    33: "the target is not valid",
}
_REPORT = re.compile(r"<([A-Za-z]+)(?::(\d))?((?:\|[^|<>]+)*)>")
_SETTING = re.compile(rb"\$(\d+)=(-?[\d.]+)")


_BRAKING = (("Hold", 1), ("Door", 2), ("Door", 3))


@dataclass(frozen=True, slots=True)
class Report:
    """An answer to `?`.

    state : "Idle", "Run", "Hold", "Jog", "Alarm", "Door", "Check", "Home", "Sleep"
    part : behind the colon: of Hold 0 is standstill, of Door 0 is a door closed again
    position : of the machine or, if `is_work`, less the offset
    offset, override : None where this report leaves them out
    """

    state: str
    part: int
    position: tuple[float, ...]
    is_work: bool
    offset: tuple[float, ...] | None = None
    override: float | None = None

    @property
    def stands(self) -> bool:
        """Whether nothing moves."""
        moves = self.state in ("Run", "Jog", "Home")
        return not moves and (self.state, self.part) not in _BRAKING


def parse_report(line: bytes) -> Report | None:
    """Return the report in a line; None where it is damaged."""
    found = _REPORT.fullmatch(line.decode("ascii", "replace").strip())
    if found is None:
        return None
    fields = _pairs(found[3].split("|"))
    is_work = "MPos" not in fields
    try:
        position = _numbers(fields["WPos" if is_work else "MPos"])
        offset = _numbers(fields["WCO"]) if "WCO" in fields else None
        override = _numbers(fields["Ov"])[0] / 100.0 if "Ov" in fields else None
    except (KeyError, ValueError):
        return None
    if len(position) != len(AXES) or (offset and len(offset) != len(AXES)):
        return None
    part = int(found[2] or 0)
    return Report(found[1], part, position, is_work, offset, override)


def _pairs(texts: Iterable[str]) -> dict[str, str]:
    parts = (text.partition(":") for text in texts)
    return {name: value for name, _, value in parts}


def _numbers(text: str) -> tuple[float, ...]:
    return tuple(float(word) for word in text.split(","))


@dataclass(frozen=True, slots=True)
class Settings:
    """What `$$` and `$I` tell of a machine.

    step_mm : of each axis, as are rate_mm_min and acceleration_mm_s2
    buffer_bytes : that GRBL keeps of lines it has not read yet
    """

    step_mm: NDArray[np.float64]
    rate_mm_min: NDArray[np.float64]
    acceleration_mm_s2: NDArray[np.float64]
    travel: tuple[tuple[float, float], ...]
    homes: bool
    tells_inches: bool
    version: str
    words: str
    buffer_bytes: int


def parse_settings(lines: list[bytes], build: list[bytes]) -> Settings:
    """Return the settings of a machine. Raises ConnectionLost where some are lost."""
    told = {int(m[1]): float(m[2]) for line in lines if (m := _SETTING.fullmatch(line))}
    info = _pairs(line.decode("ascii", "replace").strip("[]") for line in build)
    version, _, words = info.get("VER", "").rpartition(":")
    option = info.get("OPT", "").split(",")
    try:
        steps, rate, acceleration, length = (
            np.array([told[base + axis] for axis in range(len(AXES))])
            for base in (100, 110, 120, 130)
        )
        inverted, homes, inches = int(told[23]), told[22] != 0.0, told[13] != 0.0
    except KeyError as error:
        raise ConnectionLost(
            f"GRBL's setting ${error} did not come; check baud rate and cable"
        ) from error
    # Machine positions are negative, unless homing sets the origin (letter Z).
    upwards = [
        "Z" in option[0] and bool(inverted >> axis & 1) for axis in range(len(AXES))
    ]
    travel = tuple(
        (0.0, float(size)) if up else (-float(size), 0.0)
        for size, up in zip(length, upwards, strict=True)
    )
    buffer_bytes = int(option[2]) if len(option) > 2 else 128
    return Settings(
        1.0 / steps,
        rate,
        acceleration,
        travel,
        homes,
        inches,
        version,
        words,
        buffer_bytes,
    )
