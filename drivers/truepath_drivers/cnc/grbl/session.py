"""A GRBL that is connected: its one line, both ways. The caller locks."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from dataclasses import replace

from truepath_drivers import host_clock
from truepath_drivers.cnc.grbl.program import Block
from truepath_drivers.cnc.grbl.protocol import (
    ALARMS,
    ASK,
    ERRORS,
    HOLD,
    RESET,
    Report,
    Settings,
    parse_report,
    parse_settings,
)
from truepath_drivers.cnc.grbl.stream import Stream
from truepath_drivers.interfaces.errors import (
    ConnectionLost,
    DeviceTimeout,
    Refused,
    WrongDevice,
)
from truepath_drivers.transport.byte_port import BytePort
from truepath_drivers.transport.line_link import LineLink

log = logging.getLogger(__name__)

_ASK_AGAIN_S = 0.2
_GLANCE_S = 0.005  # for what has come already
_ROUNDS = 30  # in which a queue of 15 lines has been filled
_OFFSET_LOOKS = 40  # GRBL tells the offset in every thirtieth report
_BUSY = 8


class GrblSession:
    """Lines that GRBL reads in their order, and characters that it obeys at once.

    alarm : code of the last one, 0 where there is none
    error : what GRBL said of a line that it did not take
    starts : how often it began anew, unasked
    is_homed : None where nobody here has seen it
    """

    def __init__(self, port: BytePort, open_s: float, reply_s: float) -> None:
        self._link = LineLink(port)
        self._open_s, self._reply_s = open_s, reply_s
        self._told: list[bytes] = []
        self._report: Report | None = None
        self._offset: tuple[float, ...] | None = None
        self.override: float | None = None
        self.settings: Settings | None = None
        self.stream = Stream()
        self.alarm, self.error, self.starts = 0, "", 0
        self.is_homed: bool | None = None
        self.is_homing = False

    @property
    def name(self) -> str:
        """Path of the port."""
        return self._link.name

    @property
    def is_open(self) -> bool:
        """Whether it was opened and not lost since."""
        return self._link.is_open

    def open(self) -> Settings:
        """Connect, end what is left of an earlier motion, and read what machine it is.

        Many boards begin anew when their port is opened: an axis has to be homed then.
        """
        self.close()
        self._link.open()
        try:
            report = self._find()
            if report.state in ("Run", "Jog", "Hold"):
                self._end_left_over(report)
            settings = parse_settings(self.command("$$"), self._read_build())
            if settings.version and not settings.version.startswith("1.1"):
                raise WrongDevice(
                    f"{self.name}: GRBL {settings.version} answers; this driver "
                    "speaks with 1.1"
                )
            if settings.tells_inches:
                raise Refused(f"{self.name}: GRBL tells inches; set $13=0")
            self._learn_offset()
        except BaseException:
            self.close()
            raise
        self.settings = settings
        return settings

    def close(self) -> None:
        """Release the port. Idempotent."""
        self.settings = self._report = self._offset = self.override = None
        self.stream, self.is_homing, self.is_homed = Stream(), False, None
        self.alarm, self.error = 0, ""
        self._link.close()

    def signal(self, character: bytes) -> None:
        """Send a character that acts at once, from any thread, without a lock."""
        self._link.send(character, end=b"")

    def begin(self, blocks: Iterable[Block], *, homes: bool = False) -> None:
        """Have lines sent, from now on and whenever the machine is looked at."""
        size = self.settings.buffer_bytes if self.settings else 0
        self.stream, self.error, self.is_homing = Stream(blocks, size), "", homes
        self._link.send(self.stream.take(), end=b"")

    def look(self) -> Report:
        """Ask for the state, take the replies that have come, send what fits now.

        GRBL answers no question while it homes: then the last position is told.
        """
        if self.is_homing:
            self._take_until(host_clock.now_s() + _GLANCE_S)
            if self.is_homing and self._report is not None:
                return replace(self._report, state="Home", part=0)
        report = self._ask()
        for _ in range(_ROUNDS):
            if not self._feed():
                break
            report = self._ask()
        return report

    def position(self, report: Report) -> tuple[float, ...]:
        """Return where the axes are, in the machine's own coordinates."""
        if not report.is_work:
            return report.position
        offset = self._offset or (0.0,) * len(report.position)
        return tuple(a + b for a, b in zip(report.position, offset, strict=True))

    def command(self, text: str) -> list[bytes]:
        """Have one line done; return what GRBL says to it. Raises Refused."""
        self._told, self.error = [], ""
        self.stream = Stream([Block(f"{text}\n".encode())], 128)
        self._link.send(self.stream.take(), end=b"")
        deadline_s = host_clock.now_s() + self._reply_s
        while not self.stream.is_done:
            if not self._take_one(deadline_s):
                self.stream = Stream()
                raise DeviceTimeout(f"{self.name}: no answer to {text}")
        if self.error:
            raise Refused(f"{self.name}: {self.error}", _code_of(self.error))
        return self._told

    def halt(self) -> None:
        """Begin anew what stands: what GRBL had of a motion is gone."""
        self._restart()
        self.is_homing = False

    def explain_alarm(self) -> str:
        """Return the alarm by its code and name."""
        return f"ALARM:{self.alarm}, {ALARMS.get(self.alarm, 'unknown to GRBL 1.1')}"

    def _restart(self) -> None:
        starts, homed = self.starts, self.is_homed
        self.stream = Stream()
        self.signal(RESET)
        deadline_s = host_clock.now_s() + self._open_s
        while self.starts == starts:
            if not self._take_one(deadline_s):
                raise DeviceTimeout(f"{self.name}: does not come back after a reset")
        self.starts = starts
        self.is_homed = None if self.alarm else homed

    def _feed(self) -> bool:
        lines = b"" if self.error or self.alarm else self.stream.take()
        if lines:
            self._link.send(lines, end=b"")
        return bool(lines)

    def _ask(self) -> Report:
        self._take_until(host_clock.now_s() + _GLANCE_S)  # replies of before
        self._report = None
        self.signal(ASK)
        deadline_s = host_clock.now_s() + self._reply_s
        while self._report is None:
            if not self._take_one(deadline_s):
                raise DeviceTimeout(
                    f"{self.name}: GRBL does not answer; it drives what it has, a "
                    "second or so, and stands then. Is the cable plugged in?"
                )
        return self._report

    def _take_until(self, deadline_s: float) -> None:
        while self._take_one(deadline_s):
            pass

    def _take_one(self, deadline_s: float) -> bool:
        line = self._link.receive(deadline_s)
        if line is None:
            return False
        if line == b"ok":
            self._take_answer()
        elif line.startswith(b"error:"):
            code = _number(line)
            block = self.stream.answer()
            text = block.text.decode().strip() if block else "a line"
            self.error = f"error:{code} at {text}, {ERRORS.get(code, 'not taken')}"
        elif line.startswith(b"ALARM:"):
            self.alarm, self.is_homing, self.is_homed = _number(line), False, None
        elif line.startswith(b"Grbl "):
            self.starts += 1
            self.stream, self.is_homing, self.is_homed = Stream(), False, None
        elif line.startswith(b"<"):
            self._take_report(parse_report(line))
        else:
            self._told.append(line)
        return True

    def _take_answer(self) -> None:
        if self.stream.answer() is None:
            log.warning("%s: GRBL answers what was not asked", self.name)
        elif self.is_homing:
            self.is_homing, self.is_homed = False, True

    def _take_report(self, report: Report | None) -> None:
        if report is None:
            return
        self._report = report
        self._offset = report.offset or self._offset
        self.override = self.override if report.override is None else report.override
        if report.state != "Alarm":
            self.alarm = 0

    def _find(self) -> Report:
        deadline_s = host_clock.now_s() + self._open_s
        while host_clock.now_s() < deadline_s:
            self.signal(ASK)
            again_s = host_clock.now_s() + _ASK_AGAIN_S
            while self._take_one(again_s):
                if self._report is not None:
                    return self._report
        if self._link.has_received:
            raise WrongDevice(
                f"{self.name}: something answers, but not as GRBL 1.1 does; check "
                "baudrate and port"
            )
        raise DeviceTimeout(
            f"{self.name}: nothing answers; check port, cable and power of the control"
        )

    def _end_left_over(self, report: Report) -> None:
        """The port is ours alone: what runs is left of somebody who has gone."""
        log.warning("%s: GRBL is in %s; it is ended", self.name, report.state)
        self.signal(HOLD)
        deadline_s = host_clock.now_s() + self._open_s
        while not (report.state == "Hold" and report.stands):
            if report.state == "Idle" or host_clock.now_s() > deadline_s:
                break
            report = self._ask()
        self._restart()

    def _read_build(self) -> list[bytes]:
        try:
            return self.command("$I")
        except Refused as refused:
            if refused.code == _BUSY:  # at an open door
                return []
            raise

    def _learn_offset(self) -> None:
        for _ in range(_OFFSET_LOOKS):
            if not self._ask().is_work or self._offset is not None:
                return
        raise ConnectionLost(f"{self.name}: GRBL does not tell its offset; set $10=1")


def _number(line: bytes) -> int:
    digits = line.partition(b":")[2].strip()
    return int(digits) if digits.isdigit() else 0


def _code_of(error: str) -> int:
    return _number(error.split(" ", 1)[0].encode())
