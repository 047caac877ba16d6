"""The protocol of GRBL 1.1, and paths as lines of a twentieth of a second each.

Reports, settings, alarms, characters that act at once. The last line of a row waits
until the axes stand and the dwell is over (`G4`), which is the exact stop that GRBL has
no word for; its reply says that the row is done.

Source: GRBL's own interface, commands and code lists (github.com/gnea/grbl, doc).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truepath_drivers.interfaces.errors import ConnectionLost
from truepath_drivers.interfaces.records import Path
from truepath_drivers.streams.line_feeding import Line

HOLD, RESUME, ASK, RESET, DOOR = b"!", b"~", b"?", b"\x18", b"\x84"
TEN_LESS, ONE_LESS = b"\x92", b"\x94"
AXES = ("X", "Y", "Z")
SILENT_ALARMS = (1, 2)  # no `?` is answered before a reset
ALARMS = {
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
ERRORS = {
    5: "homing is not enabled ($22=0)",
    8: "not while it runs or holds",
    9: "locked by an alarm",
    13: "a door is open",
    20: "an unknown G-code",
}
_STANDS = {"Idle", "Hold:0", "Door:0", "Door:1", "Alarm", "Check", "Sleep"}
_BRAKES = {"Hold:0", "Hold:1", "Door:0", "Door:1", "Door:2"}
_NUMBER = rb"(-?\d+\.\d+)"
_REPORT = re.compile(
    rb"<(\w+(?::\d)?)\|MPos:%b,%b,%b(?:\|[^|<>]+)*>" % ((_NUMBER,) * 3)
)
_OVERRIDE = re.compile(rb"\|Ov:(\d+),")
_SETTING = re.compile(rb"\$(\d+)=(-?[\d.]+)")
_BUILD = re.compile(rb"\[VER:([^:]*):(.*)\]")
_OPTION = re.compile(rb"\[OPT:([^,\]]*),(\d+),(\d+).*\]")


@dataclass(frozen=True, slots=True)
class Report:
    """An answer to `?`.

    state : with its part after the colon: "Hold:1" brakes, "Hold:0" is at rest
    override : None where this report leaves it out
    """

    state: str
    position: tuple[float, ...]
    override: float | None = None

    @property
    def is_at_rest(self) -> bool:
        """Whether nothing moves; an unknown state may."""
        return self.state in _STANDS

    @property
    def brakes(self) -> bool:
        """Whether a hold is in effect: only a resume lets it move again."""
        return self.state in _BRAKES


def parse_report(line: bytes) -> Report | None:
    """Report in a line; None if it is damaged or has no machine position."""
    found = _REPORT.fullmatch(line)
    if found is None:
        return None
    override = _OVERRIDE.search(line)
    return Report(
        found[1].decode(),
        (float(found[2]), float(found[3]), float(found[4])),
        int(override[1]) / 100.0 if override else None,
    )


@dataclass(frozen=True, slots=True)
class Settings:
    """Settings of a machine, as `$$` and `$I` report them.

    step_mm, rate_mm_min, acceleration_mm_s2 : of each axis
    options : letters of what it was built with
    queue : lines that it plans ahead
    buffer_bytes : that it keeps of lines it has not read yet
    """

    step_mm: NDArray[np.float64]
    rate_mm_min: NDArray[np.float64]
    acceleration_mm_s2: NDArray[np.float64]
    travel: tuple[tuple[float, float], ...]
    homes: bool
    has_soft_limits: bool
    keeps_drives_on: bool
    reports_machine_mm: bool
    version: str
    words: str
    options: str
    queue: int
    buffer_bytes: int


def parse_settings(lines: list[bytes], build: list[bytes]) -> Settings:
    """Settings of a machine. Raises ConnectionLost if some are missing."""
    told = {int(m[1]): float(m[2]) for line in lines if (m := _SETTING.fullmatch(line))}
    version = next((m for line in build if (m := _BUILD.fullmatch(line))), None)
    option = next((m for line in build if (m := _OPTION.fullmatch(line))), None)
    try:
        steps, rate, acceleration, length = (
            np.array([told[base + axis] for axis in range(len(AXES))])
            for base in (100, 110, 120, 130)
        )
        shown, inches, inverted = int(told[10]), told[13] != 0.0, int(told[23])
        homes, has_soft_limits = told[22] != 0.0, told[20] != 0.0
        keeps_drives_on = told[1] == 255.0
    except KeyError as error:
        raise ConnectionLost(
            f"GRBL's setting ${error} did not come; check baud rate and cable"
        ) from error
    if option is None:
        raise ConnectionLost("GRBL's options ([OPT:) did not come; check the cable")
    # Machine positions are negative, unless homing sets the origin (letter Z).
    sets_origin = b"Z" in option[1]
    return Settings(
        1.0 / steps,
        rate,
        acceleration,
        tuple(
            (0.0, float(size))
            if sets_origin and inverted >> axis & 1
            else (-float(size), 0.0)
            for axis, size in enumerate(length)
        ),
        homes,
        has_soft_limits,
        keeps_drives_on,
        bool(shown & 1) and not inches,
        version[1].decode() if version else "",
        version[2].decode("ascii", "replace") if version else "",
        option[1].decode("ascii", "replace"),
        int(option[2]),
        min(int(option[3]), 128),
    )


START = b"G21G90G94G17G40G49G80\n"
_AHEAD_S = 0.9  # of motion in GRBL's queue, which it completes without requests
LASTS_S = (
    0.5  # that a full queue lasts at least: pieces of a row that begins are shorter
)
_BRAKING = 0.8  # share of the queue in which a motion can stop
_DWELL_SHARE = 1.1  # of its clock, which is no quartz on every board


@dataclass(frozen=True, slots=True)
class Block(Line):
    """A line, and what its reply means.

    end : position it moves to; empty if it moves nothing
    ends_row : the row is complete, its dwell is over
    wait_s : longest that GRBL may be idle during it
    """

    end: tuple[float, ...] = ()
    ends_row: bool = False
    wait_s: float = 0.0


def write_blocks(
    path: Path,
    begin: Sequence[float],
    settings: Settings,
    find_override: Callable[[], float],
) -> Iterator[Block]:
    """Yield the lines of a path from the present position."""
    yield Block(START, is_barrier=True)
    here = np.asarray(begin, np.float64)
    for row, there in enumerate(path.position):
        feed, step, done = float(path.feed_mm_min[row]), there - here, 0.0
        while done < 1.0:
            done += _find_piece(step, done, feed * find_override(), settings)
            at = there if done >= 1.0 else here + step * done
            ends = (f"{axis}{value:.4f}" for axis, value in zip(AXES, at, strict=True))
            line = f"G53G1{''.join(ends)}F{feed:.2f}\n".encode()
            yield Block(line, end=(float(at[0]), float(at[1]), float(at[2])))
        dwell_s = float(path.dwell_s[row])
        yield Block(
            f"G4P{dwell_s:.3f}\n".encode(),
            is_barrier=True,
            ends_row=True,
            wait_s=_DWELL_SHARE * dwell_s,
        )
        here = there


def find_least_feed(settings: Settings) -> float:
    """Lowest feed, mm/min, at which each line is a motor step or more.

    GRBL plans no shorter ones, and its queue would last indefinitely.
    """
    return 60.0 * float(settings.step_mm.max()) * settings.queue / _AHEAD_S


def _find_piece(
    step: NDArray[np.float64], done: float, feed_mm_min: float, settings: Settings
) -> float:
    """Share of a row that is sent as the next line, after the share `done`.

    Each lasts equally long at the speed reached by then, so that little motion is left
    when requests cease. GRBL never reaches a speed from which the axes cannot stop
    within its queue.
    """
    length = float(np.linalg.norm(step))
    if length == 0.0:
        return 1.0
    share = np.maximum(np.abs(step) / length, 1e-9)
    limit = float((settings.acceleration_mm_s2 / share).min())
    speed = min(feed_mm_min, float((settings.rate_mm_min / share).min())) / 60.0
    piece_s = _AHEAD_S / settings.queue
    come_to = max(np.sqrt(2.0 * limit * done * length), limit * piece_s)
    speed = min(speed, come_to, 2.0 * _BRAKING * _AHEAD_S * limit)
    return speed * piece_s / length
