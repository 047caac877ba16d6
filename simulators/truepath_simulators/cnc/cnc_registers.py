"""Register map of the CNC over its controller, as read and written by masters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from truepath_drivers.cnc.modbus import registers as regmap
from truepath_drivers.cnc.modbus.map_records import (
    decode,
    encode,
    path_crc,
    position_counts,
)
from truepath_drivers.cnc.modbus.registers import (
    BY_NAME,
    Access,
    AxisKind,
    Command,
    HoldReason,
    Result,
)
from truepath_drivers.interfaces.records import MotionState
from truepath_simulators.cnc.cnc_controller import MAX_FEED_MM_MIN, Controller
from truepath_simulators.cnc.modbus import (
    ILLEGAL_ADDRESS,
    ILLEGAL_VALUE,
    ModbusError,
    Registers,
)
from truepath_simulators.machine_file import Axis, RotaryAxis
from truepath_simulators.motion.program import Arc, Program

_BLOCKS = (
    regmap.IDENTITY,
    regmap.STATUS,
    regmap.READINESS,
    regmap.ALARM_TEXT,
    regmap.CONTROL,
    regmap.LIMITS,
    regmap.COMMAND,
)
_EXISTING = frozenset(
    address for b in _BLOCKS for address in range(b.address, b.address + b.count)
)
_WRITABLE = frozenset(
    address
    for register in regmap.REGISTERS
    if register.access is Access.WRITE
    for address in range(register.address, register.end)
)
_SHORTEST_WATCHDOG_MS = 100
_LONGEST_WATCHDOG_MS = 10_000
_LEFT_BY_RESET = (MotionState.ALARM, MotionState.ESTOP, MotionState.NOT_READY)
_BEATING = frozenset({Command.MOVE_TO, Command.START, Command.RESUME})


@dataclass(frozen=True, slots=True)
class Clocks:
    """Machine seconds, and wall seconds in which the device ran; read on demand."""

    machine_s: Callable[[], float]
    wall_s: Callable[[], float]


class CncRegisters(Registers):
    """Holding registers of one controller, the same for every master."""

    def __init__(self, controller: Controller, clocks: Clocks, serial: str) -> None:
        self.staying_cause: MotionState | None = None
        self._controller = controller
        self._clocks = clocks
        self._words = [0] * (max(_EXISTING) + 1)
        self._staged = np.zeros((regmap.MAX_WAYPOINTS, regmap.ROW_WORDS), np.uint16)
        self._arcs: dict[int, np.ndarray] = {}
        self._path_crc = 0
        self._scale, self._off_mm = 1.0, 0.0
        self._last_beat_s = clocks.wall_s()
        self._watchdog_ms = round(1000 * regmap.DEFAULT_WATCHDOG_S)
        self._describe(serial)
        self._put("watchdog", self._watchdog_ms)

    def read(self, address: int, count: int) -> list[int]:
        """Registers; those of the status are current. Raises ModbusError."""
        self._check(address, count, _EXISTING)
        if address < BY_NAME["alarm_text"].end and address + count > 100:
            self._refresh(self._clocks.machine_s())
        return self._words[address : address + count]

    def write(self, address: int, values: list[int]) -> None:
        """Write registers, then execute their command. Raises ModbusError."""
        self._check(address, len(values), _WRITABLE)
        if address == regmap.COMMAND.address:
            self._check_covered(values)
        before = self._value("heartbeat")
        self._words[address : address + len(values)] = values
        if self._value("heartbeat") != before:
            self._beat()
        self._update_watchdog()
        if address == regmap.LIMITS.address:
            self._limit_override(values[0] / regmap.OVERRIDE_COUNTS)
        sequence = self._value("command_sequence")
        if sequence not in (0, self._value("command_ack")):
            result = self._run(self._value("command"))
            self._put("command_result", int(result))
            self._put("command_ack", sequence)

    def watch(self) -> None:
        """Hold the feed if the host has been silent for too long."""
        silent_s = self._clocks.wall_s() - self._last_beat_s
        if silent_s > 1e-3 * self._watchdog_ms:
            self._controller.hold(HoldReason.WATCHDOG, self._clocks.machine_s())

    def falsify_identity(self) -> None:
        """Answer like another device."""
        self._put("magic", 0)
        self._put("model", "Pump drive")

    def falsify_position(self, scale: float, off_mm: float) -> None:
        """Show positions times a scale, plus an offset."""
        self._scale, self._off_mm = scale, off_mm

    def _check(self, address: int, count: int, allowed: frozenset[int]) -> None:
        if not allowed.issuperset(range(address, address + count)):
            raise ModbusError(ILLEGAL_ADDRESS)

    def _check_covered(self, values: list[int]) -> None:
        """Rejects a new number without its verb, or a verb without its arguments."""
        if values[0] in (0, self._value("command_ack")):
            return
        try:
            command = Command(values[1])
            row_count = values[3] if command is Command.PUT_ROWS else 0
        except ValueError:
            return  # answered as UNKNOWN_COMMAND
        except IndexError as error:
            raise ModbusError(ILLEGAL_VALUE) from error
        if len(values) < regmap.count_command_words(command, row_count):
            raise ModbusError(ILLEGAL_VALUE)

    def _describe(self, serial: str) -> None:
        machine = self._controller.machine
        self._put("magic", regmap.MAGIC)
        self._put("order_test", regmap.ORDER_TEST)
        self._put("map_version", regmap.MAP_VERSION)
        self._put("axis_count", len(machine.axes))
        self._put("axis_names", [ord(name) for name in machine.axis_names])
        self._put("axis_kinds", [int(_kind(axis)) for axis in machine.axes])
        self._put("max_waypoints", regmap.MAX_WAYPOINTS)
        self._put("features", self._controller.features)
        self._put("maker", "Truepath")
        self._put("model", self._controller.model)
        self._put("serial_number", serial)
        self._put("firmware", "1.0")
        self._put("travel_min", position_counts(machine.low.tolist()))
        self._put("travel_max", position_counts(machine.high.tolist()))
        self._put("max_feed", round(MAX_FEED_MM_MIN * regmap.FEED_COUNTS))

    def _refresh(self, now_s: float) -> None:
        controller = self._controller
        controller.update(now_s)
        self._put("state", regmap.STATES.index(controller.state))
        self._put("hold_reason", int(controller.hold_reason))
        self._put("alarm_code", controller.alarm_code)
        self._put("line", controller.line(now_s))
        path = controller.path
        self._put("path_rows", 0 if path is None else len(path))
        self._put("path_crc", 0 if path is None else self._path_crc)
        override = round(controller.feed_override * regmap.OVERRIDE_COUNTS)
        self._put("override", override)
        feed = round(controller.feed_mm_min(now_s) * regmap.FEED_COUNTS)
        self._put("feed", feed)
        shown = self._scale * controller.position(now_s) + self._off_mm
        self._put("position", position_counts(shown.tolist()))
        self._put("alarm_text", controller.alarm_text)
        referenced = regmap.IS_REFERENCED if controller.is_referenced else 0
        compensates = regmap.IS_COMPENSATING if controller.is_compensating else 0
        self._put("readiness", referenced | compensates)

    def _run(self, code: int) -> Result:
        try:
            command = Command(code)
        except ValueError:
            return Result.UNKNOWN_COMMAND
        now_s = self._clocks.machine_s()
        self._controller.update(now_s)
        refusal = self._controller.find_state_conflict(command)
        if refusal is not None:
            return refusal
        if command in _BEATING:
            self._beat()
        return self._VERBS[command](self, now_s)

    def _move_to(self, now_s: float) -> Result:
        row = self._program(self._rows_sent(1))
        fault = self._controller.check_program(row)
        if fault is None:
            self._controller.move_to(row, now_s)
        return fault or Result.DONE

    def _put_rows(self, _now_s: float) -> Result:
        first, count = self._value("first_row"), self._value("row_count")
        fits = first + count <= regmap.MAX_WAYPOINTS
        if not (1 <= count <= regmap.ROWS_A_BLOCK and fits):
            return Result.BAD_ARGUMENT
        rows = self._rows_sent(count)
        fault = self._controller.check_program(self._program(rows))
        if fault is not None:
            return fault
        if first == 0:
            self._controller.discard_path()
            self._arcs = {}
        for row in range(first, first + count):
            self._arcs.pop(row, None)  # it is a straight line now
        self._staged[first : first + count] = rows
        return Result.DONE

    def _put_arc(self, _now_s: float) -> Result:
        row, words = self._value("first_row"), self._rows_sent(1)[0]
        if not self._controller.features & regmap.DRIVES_ARCS:
            return Result.UNKNOWN_COMMAND
        axes = self._controller.machine.linear_axes
        columns = divmod(int(words[-2]) << 16 | int(words[-1]), 1 << 16)
        linear = max(columns) < len(axes) and columns[0] != columns[1]
        if not (1 <= row < regmap.MAX_WAYPOINTS and linear):
            return Result.BAD_ARGUMENT
        self._arcs[row] = words
        return Result.DONE

    def _commit(self, _now_s: float) -> Result:
        count = self._value("row_count")
        if not 1 <= count <= regmap.MAX_WAYPOINTS:
            return Result.BAD_ARGUMENT
        rows = self._staged[:count]
        arcs = {row: arc for row, arc in self._arcs.items() if row < count}
        crc = path_crc(rows, arcs)
        if crc != self._value("crc"):
            return Result.CRC_MISMATCH
        program = self._program(rows)
        if arcs:
            turns = [self._arc(arcs[k]) if k in arcs else None for k in range(count)]
            program = replace(program, arc=tuple(turns))
        fault = self._controller.check_program(program)
        if fault is not None:
            return fault
        self._path_crc = crc
        self._controller.commit(program)
        return Result.DONE

    def _start(self, now_s: float) -> Result:
        path = self._controller.path
        asked = self._value("row_count"), self._value("crc")
        if path is not None and asked != (len(path), self._path_crc):
            return Result.CRC_MISMATCH
        return self._controller.start(now_s)

    def _hold(self, now_s: float) -> Result:
        self._controller.hold(HoldReason.COMMAND, now_s)
        return Result.DONE

    def _resume(self, now_s: float) -> Result:
        self._controller.resume(now_s)
        return Result.DONE

    def _abort(self, now_s: float) -> Result:
        self._controller.abort(now_s)
        return Result.DONE

    def _reset(self, _now_s: float) -> Result:
        state = self._controller.state
        if state is self.staying_cause:
            return Result.NOT_READY
        if state in _LEFT_BY_RESET:
            self._controller.enable()
        return Result.DONE

    def _home(self, _now_s: float) -> Result:
        """At once, where the axes stand."""
        if self._controller.state is MotionState.UNHOMED:
            self._controller.enable()
        self._controller.is_referenced = True
        return Result.DONE

    _VERBS: ClassVar[dict[Command, Callable[[CncRegisters, float], Result]]] = {
        Command.MOVE_TO: _move_to,
        Command.PUT_ROWS: _put_rows,
        Command.COMMIT: _commit,
        Command.START: _start,
        Command.HOLD: _hold,
        Command.RESUME: _resume,
        Command.ABORT: _abort,
        Command.RESET: _reset,
        Command.HOME: _home,
        Command.PUT_ARC: _put_arc,
    }

    def _rows_sent(self, count: int) -> np.ndarray:
        at = BY_NAME["rows"].address
        words = self._words[at : at + count * regmap.ROW_WORDS]
        return np.array(words, np.uint16).reshape(count, regmap.ROW_WORDS)

    def _program(self, rows: np.ndarray) -> Program:
        values = rows.astype(">u2").view(">i4").astype(float)
        axes = len(self._controller.machine.axes)
        return Program(
            values[:, :axes] / regmap.POSITION_COUNTS,
            values[:, regmap.MAX_AXES] / regmap.FEED_COUNTS / 60.0,
            values[:, regmap.MAX_AXES + 1] / regmap.DWELL_COUNTS,
        )

    def _arc(self, words: np.ndarray) -> Arc:
        *centre, turn, _ = words.astype(">u2").view(">i4").astype(float)
        first, second = int(words[-2]), int(words[-1])
        return Arc(
            (first, second),
            (
                centre[first] / regmap.POSITION_COUNTS,
                centre[second] / regmap.POSITION_COUNTS,
            ),
            float(np.radians(turn / regmap.POSITION_COUNTS)),
        )

    def _beat(self) -> None:
        self._last_beat_s = self._clocks.wall_s()

    def _limit_override(self, largest: float) -> None:
        if 0.0 < largest < self._controller.feed_override:
            self._controller.override(largest, self._clocks.machine_s())

    def _update_watchdog(self) -> None:
        asked_ms = self._value("watchdog")
        if _SHORTEST_WATCHDOG_MS <= asked_ms <= _LONGEST_WATCHDOG_MS:
            self._watchdog_ms = asked_ms
        self._put("watchdog", self._watchdog_ms)

    def _value(self, name: str) -> int:
        register = BY_NAME[name]
        block = regmap.Block(register.address, register.words)
        words = self._words[register.address : register.end]
        return decode(name, words, block)[0]

    def _put(self, name: str, value: int | str | list[int]) -> None:
        register = BY_NAME[name]
        self._words[register.address : register.end] = encode(name, value)


def _kind(axis: Axis) -> AxisKind:
    return AxisKind.ROTARY if isinstance(axis, RotaryAxis) else AxisKind.LINEAR
