"""A controller that keeps GRBL 1.1's published rules, without its wire. Time is given.

128 bytes of unread lines, a queue of 15 blocks, `ok` or `error:N` once a line is read,
`G4` only at standstill, ALARM:3 for a reset in motion. Characters that act at once are
flags which the main loop looks at: of those that come together each counts once, and a
hold goes before a resume. While it homes and after ALARM:1 and 2 it hears a reset only.

Source: GRBL's documentation and its protocol.c, limits.c and motion_control.c.
"""

from __future__ import annotations

import re
import select
import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from truepath_simulators.links.links import PtyPort
from truepath_simulators.processes import LifeLine, MachineClock, is_question

RX_BYTES, QUEUE_BLOCKS, LINE_BYTES = 128, 15, 80
_STEP_S = 0.001
_DWELL_STEP_S = 0.05
_HOMING_S = 0.5
_RESET_S = 0.003  # in which all that comes is lost
_RESTORE_S = 0.2  # of a door, before it goes on
_PULL_OFF_MM = 1.0
_WORD = re.compile(rb"([A-Z])(-?\d+\.?\d*|-?\.\d+)")
_PLAIN = {17, 21, 40, 49, 54, 61, 80, 90, 94}
_OVERRIDES = {0x91: 10, 0x92: -10, 0x93: 1, 0x94: -1}
_REALTIME = b"!~?\x18\x84" + bytes(range(0x90, 0x95))


@dataclass(slots=True)
class _Block:
    end: np.ndarray
    feed_mm_s: float


class GrblDevice:
    """Takes bytes and says bytes; `update` lets time pass.

    drops : replies `ok` to leave out from now on, as a line does that loses bytes
    deaf : characters that act at once to lose from now on
    homing_fails : the alarm in which homing ends, 0 where it succeeds
    startup : the line that it runs after a reset, `$N0`
    is_mute : takes and says nothing, as a control does that hangs; it drives on
    """

    def __init__(self, *, homes: bool = True, words: str = "SIM-G1") -> None:
        self.settings: dict[int, float] = {
            **{1: 255, 10: 1, 13: 0, 20: 1, 22: float(homes), 23: 0, 32: 0},
            **dict.fromkeys((100, 101, 102), 1000.0),
            **dict.fromkeys((110, 111, 112), 6000.0),
            **dict.fromkeys((120, 121, 122), 500.0),
            **{130: 300.0, 131: 200.0, 132: 100.0},
        }
        self.words = words
        self.position = np.zeros(3)
        self.offset = np.array([-12.5, 3.0, 0.0])
        self.state = "Alarm" if homes else "Idle"
        self.drops, self.deaf, self.is_mute = 0, 0, False
        self.homing_fails, self.startup = 0, ""
        self._flags: set[int] = set()
        self._restore_s = self._reset_s = 0.0
        self.executed: list[bytes] = []
        self.overflows = 0
        self._queue: deque[_Block] = deque()
        self._rx = b""
        self._out = b""
        self._part = 0
        self._is_critical = False
        self._feed_mm_min, self._override = 0.0, 100
        self._speed = 0.0
        self._now_s: float | None = None
        self._dwell_s: float | None = None  # of a `G4` that waits, left
        self._homing_s = 0.0
        self._door = False
        self._reports = 0
        self._welcome()

    def receive(self, data: bytes) -> None:
        if self.is_mute:
            return
        for value in data:
            byte = bytes([value])
            if byte in _REALTIME and self.deaf:
                self.deaf -= 1
            elif byte == b"\x18":
                self._reset()
            elif byte in _REALTIME:
                self._flags.add(value)
            elif len(self._rx) < RX_BYTES:
                self._rx += byte
            else:
                self.overflows += 1
        self._obey()
        self._read_lines()

    def take(self) -> bytes:
        said, self._out = self._out, b""
        return b"" if self.is_mute else said

    def update(self, now_s: float) -> None:
        if self._now_s is None:
            self._now_s = now_s
        while self._now_s + _STEP_S <= now_s:
            self._now_s += _STEP_S
            waits = self._homing_s or self._dwell_s or self._restore_s > 0.0
            if not (self._queue or self._rx or waits or self._reset_s > 0.0):
                self._now_s += (now_s - self._now_s) // _STEP_S * _STEP_S
            self._step()

    def open_door(self, is_open: bool) -> None:
        self._door = is_open
        if is_open and self.state == "Home":
            self.trip(7)
        elif is_open and self.state != "Alarm":
            self.state, self._part = "Door", 2 if self._speed else 1
        elif self.state == "Door" and self._part == 1:
            self._part = 0

    def trip(self, code: int) -> None:
        """Stop by an alarm; nothing but a reset helps after a limit switch."""
        self._drop_motion()
        self.state, self._is_critical = "Alarm", code in (1, 2)
        self._say(f"ALARM:{code}")
        if self._is_critical:
            self._say("[MSG:Reset to continue]")
        elif code in (3, 6, 7, 8, 9):
            self._welcome()

    def restart(self) -> None:
        """Begin anew, as after a power cut."""
        self._drop_motion()
        self.state = "Alarm" if self.settings[22] else "Idle"
        self._is_critical = False
        self._welcome()

    def _obey(self) -> None:
        """Look at the flags, as the main loop does; homing does not get there."""
        is_deaf = self._is_critical or self.state == "Home" or self._reset_s > 0.0
        if not self._flags or is_deaf:
            return
        flags, self._flags = self._flags, set()
        if ord("?") in flags:
            self._say(self._report())
        if 0x84 in flags and self.state != "Alarm":
            self.state, self._part = "Door", 2 if self._speed else int(self._door)
        elif ord("!") in flags:
            self._hold()
        elif ord("~") in flags:
            self._go_on()
        before = self._override
        self._override = 100 if 0x90 in flags else self._override
        self._override += sum(_OVERRIDES[f] for f in flags if f in _OVERRIDES)
        self._override = min(max(self._override, 10), 200)
        if self._override != before:
            self._override_changed = True

    def _hold(self) -> None:
        if self.state in ("Idle", "Run"):
            self._part = 1 if self.state == "Run" else 0
            self.state = "Hold"

    def _go_on(self) -> None:
        if self._part or self._door:
            return
        if self.state == "Hold":
            self.state = "Run" if self._queue else "Idle"
        elif self.state == "Door":
            self._part, self._restore_s = 3, _RESTORE_S

    def _reset(self) -> None:
        moves = self._speed > 0.0 or self.state == "Home"
        homing = self.state == "Home"
        self._drop_motion()
        if moves:
            self.state = "Alarm"
            self._say(f"ALARM:{6 if homing else 3}")
        elif self.state != "Alarm":
            self.state = "Idle"
        self._is_critical = False
        self._reset_s = _RESET_S

    def _drop_motion(self) -> None:
        self._queue.clear()
        self._rx, self._speed, self._homing_s = b"", 0.0, 0.0
        self._dwell_s, self._override = None, 100
        self._flags.clear()
        self._part = 0

    def _welcome(self) -> None:
        self._reports, self._override_changed = 0, True
        self._say("")
        self._say("Grbl 1.1h ['$' for help]")
        if self.state == "Alarm":
            self._say("[MSG:'$H'|'$X' to unlock]")
        elif self._door:
            self.open_door(True)
        elif self.startup:
            self._do_block(self.startup.encode())

    def _report(self) -> str:
        # Offset and overrides come after a reset, then in every tenth report.
        fields = [f"{self.state}:{self._part}"]
        if self.state not in ("Hold", "Door"):
            fields = [self.state]
        is_machine = int(self.settings[10]) & 1
        shown = self.position - (0.0 if is_machine else self.offset)
        name = "MPos" if is_machine else "WPos"
        fields.append(f"{name}:{_join(shown)}")
        fields.append(f"FS:{60.0 * self._speed:.0f},0")
        if self._reports % 10 == 0:
            fields.append(f"WCO:{_join(self.offset)}")
        elif self._reports % 10 == 1 or self._override_changed:
            self._override_changed = False
            fields.append(f"Ov:{self._override},100,100")
        self._reports += 1
        return f"<{'|'.join(fields)}>"

    def _read_lines(self) -> None:
        """Read lines while there is room, in their order."""
        while self._is_free() and (found := re.match(rb"([^\r\n]*)[\r\n]", self._rx)):
            self._rx = self._rx[found.end() :]
            self._answer(found[1].strip())

    def _is_free(self) -> bool:
        waits = self.state in ("Hold", "Home", "Door") or self._is_critical
        waits = waits or self._reset_s > 0.0
        return not waits and self._dwell_s is None and len(self._queue) < QUEUE_BLOCKS

    def _answer(self, line: bytes) -> None:
        if len(line) > LINE_BYTES:
            self._finish(11)
        elif line.startswith(b"$"):
            self._do_system(line)
        elif self.state == "Alarm" and line:
            self._finish(9)
        else:
            self.executed.append(line)
            self._do_block(line.replace(b" ", b"").upper())

    def _finish(self, error: int = 0) -> None:
        if error:
            self._say(f"error:{error}")
        elif self.drops:
            self.drops -= 1
        else:
            self._say("ok")

    def _do_system(self, line: bytes) -> None:
        if self.state not in ("Idle", "Alarm"):
            self._finish(8)
        elif line == b"$$":
            for number, value in sorted(self.settings.items()):
                self._say(f"${number}={value:.{3 if number > 99 else 0}f}")
            self._finish()
        elif line == b"$I":
            self._say(f"[VER:1.1h.20190830:{self.words}]")
            self._say(f"[OPT:V,{QUEUE_BLOCKS},{RX_BYTES}]")
            self._finish()
        elif line == b"$N":
            self._say(f"$N0={self.startup}")
            self._say("$N1=")
            self._finish()
        elif line == b"$X":
            self.state = "Idle"
            self._say("[MSG:Caution: Unlocked]")
            self._finish()
        elif line == b"$H" and self.settings[22] and self._door:
            self._finish(13)
        elif line == b"$H" and self.settings[22]:
            self.state, self._homing_s = "Home", _HOMING_S
        else:
            self._finish(5 if line == b"$H" else 3)

    def _do_block(self, line: bytes) -> None:
        words = _WORD.findall(line)
        if b"".join(a + b for a, b in words) != line:
            self._finish(2)
            return
        codes = {float(value) for letter, value in words if letter == b"G"}
        values = {chr(letter[0]): float(value) for letter, value in words}
        if 4.0 in codes:
            steps = np.ceil(values.get("P", 0.0) / _DWELL_STEP_S)
            self._dwell_s = float(steps) * _DWELL_STEP_S
            return
        if not codes <= _PLAIN | {1.0, 53.0}:
            self._finish(20)
            return
        self._feed_mm_min = values.get("F", self._feed_mm_min)
        if not set(values) & set("XYZ"):
            self._finish()
        elif self._feed_mm_min <= 0.0:
            self._finish(22)
        else:
            self._queue_line(values, is_machine=53.0 in codes)

    def _queue_line(self, values: dict[str, float], *, is_machine: bool) -> None:
        end = (self._queue[-1].end if self._queue else self.position).copy()
        for axis, name in enumerate("XYZ"):
            if name in values:
                end[axis] = values[name] + (0.0 if is_machine else self.offset[axis])
        step = np.array([1.0 / self.settings[100 + axis] for axis in range(3)])
        end = np.round(end / step) * step
        lengths = np.array([self.settings[130 + axis] for axis in range(3)])
        if self.settings[20] and ((end > 1e-9).any() or (end < -lengths - 1e-9).any()):
            self.trip(2)
            return
        self._queue.append(_Block(end, self._feed_mm_min / 60.0))
        if self.state == "Idle":
            self.state = "Run"
        self._finish()

    def _step(self) -> None:
        if self._reset_s > 0.0:
            self._reset_s -= _STEP_S
            if self._reset_s <= 0.0:
                self._drop_motion()
                self._welcome()
            return
        if self.state == "Home":
            self._home()
        elif self.state in ("Run", "Hold", "Door") and self._queue:
            self._drive(brakes=self.state != "Run")
        elif self._part == 1 and self.state == "Hold":
            self._part = 0
        elif self._part == 2 and self.state == "Door":
            self._part = int(self._door)
        if self._part == 3 and self.state == "Door":
            self._restore_s -= _STEP_S
            if self._restore_s <= 0.0:
                self._part, self.state = 0, "Run" if self._queue else "Idle"
        if self.state == "Run" and not self._queue:
            self.state = "Idle"
        if self._dwell_s is not None and self.state == "Idle":
            self._dwell_s -= _STEP_S
            if self._dwell_s <= 0.0:
                self._dwell_s = None
                self._finish()
        self._obey()
        self._read_lines()

    def _home(self) -> None:
        self._homing_s -= _STEP_S
        if self._homing_s <= 0.0 and self.homing_fails:
            self.trip(self.homing_fails)
        elif self._homing_s <= 0.0:
            self._homing_s, self.state = 0.0, "Idle"
            self.position = np.full(3, -_PULL_OFF_MM)
            self._finish()

    def _drive(self, *, brakes: bool) -> None:
        """Go on for a step, as fast as lets it stand where line or queue end."""
        limit = min(self.settings[120 + axis] for axis in range(3))
        feed = self._queue[0].feed_mm_s * self._override / 100.0
        feed = min(feed, min(self.settings[110 + a] for a in range(3)) / 60.0)
        allowed = min(feed, np.sqrt(2.0 * limit * self._find_way_mm()))
        if brakes:
            self._speed = max(self._speed - limit * _STEP_S, 0.0)
            if self._speed == 0.0:
                if self._part in (1, 2):
                    self._part = int(self.state == "Door" and self._door)
                return
        else:
            self._speed = min(max(allowed, 0.5), self._speed + limit * _STEP_S)
        left = self._speed * _STEP_S
        while self._queue and left > 0.0:
            step = self._queue[0].end - self.position
            length = float(np.linalg.norm(step))
            if length > left:
                self.position = self.position + step * (left / length)
                return
            self.position = self._queue.popleft().end
            left -= length
        if not self._queue:
            self._speed = 0.0

    def _find_way_mm(self) -> float:
        """Up to the next corner, or to the end of the queue."""
        here, way, before = self.position, 0.0, None
        for block in self._queue:
            step = block.end - here
            length = float(np.linalg.norm(step))
            if length == 0.0:
                continue
            if before is not None and step @ before < 0.99 * length:
                break
            way, here, before = way + length, block.end, step / length
        return way

    def _say(self, line: str) -> None:
        self._out += line.encode() + b"\r\n"


def _join(values: np.ndarray) -> str:
    return ",".join(f"{value:.3f}" for value in values)


_PERIOD_S = 0.005


def main() -> None:
    life = LifeLine()
    orders = life.orders()
    if not orders:
        return
    link = orders.get("symlink")
    port = PtyPort(Path(link) if link else None)
    clock = MachineClock(time.monotonic_ns(), orders.get("speed", 1.0))
    device = GrblDevice(homes=orders.get("homes", True))
    life.report(port.address)
    try:
        while not life.ended:
            for line in life.lines():
                _apply_event(life, device, line)
            device.update(clock.now_s())
            device.receive(port.receive() or b"")
            port.send(device.take())
            waited = [life.descriptor, *port.descriptors()]
            select.select(waited, [], [], _PERIOD_S)
    finally:
        port.close()


def _apply_event(life: LifeLine, device: GrblDevice, line: str) -> None:
    what, _, which = line.partition(" ")
    if is_question(line):
        told = {"state": device.state, "position": device.position.tolist()}
        life.report(told | {"overflows": device.overflows})
    elif what == "door":
        device.open_door(which == "open")
    elif what == "alarm":
        device.trip(int(which))
    elif what in ("mute", "speak"):
        device.is_mute = what == "mute"
    elif what == "restart":
        device.restart()


if __name__ == "__main__":
    main()
