"""The register map of the Modbus CNC gateway, as data: driver and devices share it.

Holding registers only, addresses as in the PDU (from 0), 32-bit values high word first,
texts two ASCII characters per register, padded with zeros. Positions count 0.1 µm
(linear axes) or 0.0001 deg (rotary axes), feeds 0.001 mm/min (deg/min where only rotary
axes move). docs/modbus-register-map.md is written from this file by its script.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum, StrEnum

from truepath_drivers.interfaces.records import MotionState

MAGIC = 0x54504331  # "TPC1"
ORDER_TEST = 0x01020304
MAP_VERSION = 2

MAX_AXES = 6
MAX_WAYPOINTS = 4096
ROW_WORDS = 2 * MAX_AXES + 4
ROWS_A_BLOCK = 7

POSITION_COUNTS = 10_000  # a mm or a deg
OVERRIDE_COUNTS = 1_000  # a factor of 1
FEED_COUNTS = 1_000  # a mm/min, or a deg/min where only rotary axes move
DWELL_COUNTS = 1_000  # per second
LONGEST_DWELL_S = (2**31 - 1) / DWELL_COUNTS
DEFAULT_WATCHDOG_S = 1.0


class Kind(StrEnum):
    U16 = "u16"
    U32 = "u32"
    I32 = "i32"
    TEXT = "text"


class Access(StrEnum):
    READ = "R"
    WRITE = "RW"


@dataclass(frozen=True, slots=True)
class Register:
    """One value of the map, or several alike (one per axis)."""

    name: str
    address: int
    kind: Kind
    meaning: str
    unit: str = ""
    access: Access = Access.READ
    count: int = 1  # values; for a text, registers

    @property
    def words(self) -> int:
        return self.count * (2 if self.kind in (Kind.U32, Kind.I32) else 1)

    @property
    def end(self) -> int:
        """Address after its last register."""
        return self.address + self.words


@dataclass(frozen=True, slots=True)
class Block:
    """Registers that one request reads or writes together."""

    address: int
    count: int


class Command(IntEnum):
    MOVE_TO = 1
    PUT_ROWS = 2
    COMMIT = 3
    START = 4
    HOLD = 5
    RESUME = 6
    ABORT = 7
    RESET = 8
    HOME = 9
    PUT_ARC = 10


class Result(IntEnum):
    """Outcome of the command whose number `command_ack` shows."""

    DONE = 0
    WRONG_STATE = 1
    OUT_OF_TRAVEL = 2
    NO_PATH = 3
    CRC_MISMATCH = 4
    BAD_ARGUMENT = 5
    UNKNOWN_COMMAND = 6
    IN_ALARM = 7
    NOT_READY = 8


class HoldReason(IntEnum):
    """Reason of a hold; in lower case, the words of `MotionStatus.hold_reason`."""

    NONE = 0
    OPERATOR = 1
    WATCHDOG = 2
    COMMAND = 3


# Bits of `features`: optional reports and abilities of a device.
TELLS_OVERRIDE, TELLS_REFERENCED, TELLS_COMPENSATION, DRIVES_ARCS = 1, 2, 4, 8
# Bits of `readiness`.
IS_REFERENCED, IS_COMPENSATING = 1, 2


class AxisKind(IntEnum):
    """Unit of an axis: mm or deg."""

    LINEAR = 0
    ROTARY = 1


# The position in this list is the code of the `state` register.
STATES = (
    MotionState.IDLE,
    MotionState.READY,
    MotionState.RUNNING,
    MotionState.HELD,
    MotionState.FINISHED,
    MotionState.ABORTED,
    MotionState.ALARM,
    MotionState.NOT_READY,
    MotionState.UNHOMED,
    MotionState.ESTOP,
    MotionState.DOOR,
)

_STANDING = frozenset(
    {
        MotionState.IDLE,
        MotionState.READY,
        MotionState.FINISHED,
        MotionState.ABORTED,
    }
)
# Elsewhere the answer is WRONG_STATE; in alarm IN_ALARM; in NOT_READY, UNHOMED, ESTOP
# and DOOR NOT_READY. HOLD, RESUME, ABORT and RESET are done everywhere; where there is
# nothing to do they do nothing.
ALLOWED: dict[Command, frozenset[MotionState]] = {
    Command.MOVE_TO: _STANDING,
    Command.PUT_ROWS: _STANDING,
    Command.COMMIT: _STANDING,
    Command.START: _STANDING,
    Command.HOLD: frozenset(STATES),
    Command.RESUME: frozenset(STATES),
    Command.ABORT: frozenset(STATES),
    Command.RESET: frozenset(STATES),
    Command.HOME: _STANDING | {MotionState.UNHOMED},
    Command.PUT_ARC: _STANDING,
}

_U16, _U32, _I32, _TEXT = Kind.U16, Kind.U32, Kind.I32, Kind.TEXT
_POSITION_UNIT = "0.1 µm or 0.0001 deg"
_FEED_UNIT = "0.001 mm/min"

REGISTERS: tuple[Register, ...] = (
    Register("magic", 0, _U32, "0x54504331, ASCII `TPC1`: this map answers"),
    Register("order_test", 2, _U32, "0x01020304: shows a wrong word or byte order"),
    Register("map_version", 4, _U16, "2"),
    Register("axis_count", 5, _U16, "axes in use, 1 to 6"),
    Register("axis_names", 6, _U16, "ASCII code of each axis name", count=MAX_AXES),
    Register("axis_kinds", 12, _U16, "0 linear, 1 rotary", count=MAX_AXES),
    Register("max_waypoints", 18, _U16, "rows that a path may have, 4096 at least"),
    Register(
        "features",
        19,
        _U16,
        "sum of what is told: 1 `override`, and its 0 is a feed of nothing; 2 and 4 "
        "the summands 1 and 2 of `readiness`; 8 that it drives arcs (PUT_ARC)",
    ),
    Register("maker", 20, _TEXT, "maker", count=8),
    Register("model", 28, _TEXT, "model", count=8),
    Register("serial_number", 36, _TEXT, "serial number", count=8),
    Register("firmware", 44, _TEXT, "firmware", count=8),
    Register("travel_min", 52, _I32, "lowest position", _POSITION_UNIT, count=MAX_AXES),
    Register(
        "travel_max", 64, _I32, "highest position", _POSITION_UNIT, count=MAX_AXES
    ),
    Register("max_feed", 76, _U32, "highest feed", _FEED_UNIT),
    Register("state", 100, _U16, "state, see below"),
    Register("hold_reason", 101, _U16, "0 not held, 1 operator, 2 watchdog, 3 command"),
    Register("alarm_code", 102, _U16, "0 no alarm"),
    Register(
        "line", 103, _U16, "row (from 0) moved towards or dwelt at; 0 before START"
    ),
    Register("path_rows", 104, _U16, "rows of the committed path, 0 without one"),
    Register("command_ack", 105, _U16, "number of the last command taken"),
    Register("command_result", 106, _U16, "what became of it, see below"),
    Register(
        "override",
        107,
        _U16,
        "feed override; where `features` lacks 1, 0 says that it is not told",
        "0.1 %",
    ),
    Register("path_crc", 108, _U32, "CRC-32 of the committed path, 0 without one"),
    Register("feed", 110, _U32, "feed now", _FEED_UNIT),
    Register("position", 112, _I32, "position now", _POSITION_UNIT, count=MAX_AXES),
    Register(
        "readiness",
        124,
        _U16,
        "sum of 1: all axes are referenced; 2: the error compensation of the control "
        "is on",
    ),
    Register("alarm_text", 130, _TEXT, "alarm in words", count=32),
    Register(
        "heartbeat", 180, _U16, "any change is a beat of the host", "", Access.WRITE
    ),
    Register("watchdog", 181, _U16, "longest silence in motion", "ms", Access.WRITE),
    Register(
        "override_limit",
        182,
        _U16,
        "a write lowers the feed override to it where that is above",
        "0.1 %",
        Access.WRITE,
    ),
    Register(
        "command_sequence",
        200,
        _U16,
        "number of this command, 1 to 65535; a new one runs it",
        "",
        Access.WRITE,
    ),
    Register("command", 201, _U16, "verb, see below", "", Access.WRITE),
    Register(
        "first_row",
        202,
        _U16,
        "PUT_ROWS: first row, from 0; PUT_ARC: the row that the arc ends at",
        "",
        Access.WRITE,
    ),
    Register(
        "row_count",
        203,
        _U16,
        "PUT_ROWS: rows that follow, 1 to 7; COMMIT, START: rows in all",
        "",
        Access.WRITE,
    ),
    Register(
        "crc",
        204,
        _U32,
        "COMMIT, START: CRC-32 of all rows and arcs",
        "",
        Access.WRITE,
    ),
    Register(
        "rows",
        206,
        _U16,
        "PUT_ROWS: the rows, 16 registers each; MOVE_TO: one row; PUT_ARC: one arc",
        "",
        Access.WRITE,
        count=ROWS_A_BLOCK * ROW_WORDS,
    ),
)

BY_NAME: dict[str, Register] = {register.name: register for register in REGISTERS}

IDENTITY = Block(0, 78)
STATUS = Block(100, 24)
READINESS = Block(124, 1)  # where `features` include it, read with the status
ALARM_TEXT = Block(130, 32)
CONTROL = Block(180, 2)
LIMITS = Block(182, 1)  # which not every device has
_VERB_WORDS, _HEAD_WORDS = 2, 6  # number and verb; those and all before the rows
COMMAND = Block(200, _HEAD_WORDS + ROWS_A_BLOCK * ROW_WORDS)


def count_command_words(command: Command, row_count: int) -> int:
    """Registers that one request has to cover for a command, number first.

    A number alone, or a verb without its arguments, would run with the contents of an
    earlier request.
    """
    match command:
        case Command.MOVE_TO | Command.PUT_ARC:
            return _HEAD_WORDS + ROW_WORDS
        case Command.PUT_ROWS:
            return _HEAD_WORDS + ROW_WORDS * min(row_count, ROWS_A_BLOCK)
        case Command.COMMIT | Command.START:
            return _HEAD_WORDS
        case _:
            return _VERB_WORDS
