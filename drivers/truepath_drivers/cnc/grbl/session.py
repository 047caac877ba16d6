"""A connected GRBL: lines out, replies in. The caller locks, except for stops."""

from __future__ import annotations

import logging
import math
import re
import threading
from collections import deque
from collections.abc import Iterable
from dataclasses import replace

from truepath_drivers import host_clock
from truepath_drivers.cnc.grbl.protocol import (
    ALARMS,
    ASK,
    DOOR,
    ERRORS,
    HOLD,
    LASTS_S,
    ONE_LESS,
    RESET,
    RESUME,
    SILENT_ALARMS,
    TEN_LESS,
    Block,
    Report,
    Settings,
    parse_report,
    parse_settings,
)
from truepath_drivers.interfaces.errors import (
    ConnectionLost,
    DeviceTimeout,
    Refused,
    WrongDevice,
)
from truepath_drivers.streams.line_feeding import LineFeed
from truepath_drivers.transport.byte_port import BytePort
from truepath_drivers.transport.line_link import LineLink

log = logging.getLogger(__name__)

_ASK_AGAIN_S = 0.2
_POLL_S = 0.02
_GLANCE_S = 0.002  # for replies that have arrived already
_MOST_LATE = 9  # answers that are discarded before one is believed
_FEEDS_S = 0.3  # after which one poll sends nothing more
_STEPS_DOWN = 20  # that lower any override to the least


class GrblSession:
    """Lines that GRBL reads in order, and characters that it obeys at once.

    stops : number of holds and aborts so far; a start or resume asked for before the
        last one is not executed
    held_by : why no line is sent and the motion is held; empty if it is not held
    is_homing : it answers nothing, and obeys a reset only
    alarm : code of the last one, 0 if there is none
    error : why no further line is sent
    rows : number of completed ones
    has_restarted : GRBL has restarted without a request, since this was cleared
    is_homed : None if not known
    starved_polls : looks, one after the other, that saw it idle for want of lines
    sent_to : where the last line that was sent drives to; empty before one
    """

    def __init__(self, port: BytePort, open_s: float, reply_s: float) -> None:
        self._link = LineLink(port)
        self._open_s, self._reply_s = open_s, reply_s
        self._wire = threading.Lock()  # the order of the wire is that of the verbs
        self.settings: Settings | None = None
        self.stops = 0
        self._discard_old()

    @property
    def name(self) -> str:
        return self._link.name

    @property
    def is_open(self) -> bool:
        return self._link.is_open

    @property
    def is_done(self) -> bool:
        return self._feed.is_done

    @property
    def is_sent(self) -> bool:
        return self._feed.is_sent

    @property
    def silence_s(self) -> float:
        """How long a reply of an idle GRBL has been overdue."""
        if not (owed := self._feed.unanswered):
            return 0.0
        return host_clock.now_s() - self._changed_s - owed[0].wait_s

    @property
    def starved_s(self) -> float:
        return host_clock.now_s() - self._starved_since_s

    @property
    def has_lost_time(self) -> bool:
        """Whether its queue ran empty sooner than a full one lasts.

        This computer was suspended meanwhile, or the queue was lost.
        """
        return self._starved_since_s - self._full_s < LASTS_S

    def open(self) -> Settings:
        """Connect, end an earlier motion, and read the settings.

        Many boards restart when their port is opened: the axes have to be homed then.
        """
        self.close()
        self._link.open()
        try:
            self._bring_to_rest()
            if self.restart().state.startswith("Door"):
                raise Refused(f"{self.name}: a door is open; close it, connect again")
            settings = parse_settings(self.command("$$"), self.command("$I"))
            if not settings.version.startswith("1.1"):
                raise WrongDevice(
                    f"{self.name}: GRBL {settings.version} answers; this driver "
                    "speaks with 1.1"
                )
            if not settings.has_soft_limits or "L" in settings.options:
                raise Refused(
                    f"{self.name}: GRBL drives beyond its travel or moves after an "
                    "alarm; set $20=1, and build it with HOMING_INIT_LOCK"
                )
            if not settings.keeps_drives_on:
                raise Refused(
                    f"{self.name}: GRBL switches its drives off where it stands: an "
                    "axis may drop; set $1=255"
                )
            if not settings.reports_machine_mm:
                raise Refused(
                    f"{self.name}: GRBL tells inches or no machine position; set $13=0 "
                    "and $10=1"
                )
            if lines := [x for x in self.command("$N") if re.match(rb"\$N\d=.", x)]:
                raise Refused(
                    f"{self.name}: GRBL runs {lines[0].decode('ascii', 'replace')} "
                    "after each reset; take it out"
                )
        except BaseException:
            self.close()
            raise
        self.settings = settings
        return settings

    def close(self) -> None:
        with self._wire:
            self.stops += 1
            self.settings = None
            self._discard_old()
        self._link.close()

    def signal(self, character: bytes) -> None:
        """Send a character that acts at once, from any thread, without a lock."""
        self._link.send(character, end=b"")

    def count_stop(self) -> None:
        """Cancel starts and resumes asked for before; hold an active motion."""
        with self._wire:
            self.stops += 1
            if self.settings and not self.is_done:
                self.held_by = "command"
                self._send_hold()

    def brake(self, why: str) -> None:
        """Hold the motion and send no more lines, from any thread, without a lock."""
        with self._wire:
            self.stops += 1
            self.held_by = why
            self._send_hold()

    def repeat_hold(self) -> None:
        """Hold again where it did not obey, or another client has released it."""
        with self._wire:
            self._send_hold()

    def release(self, stops: int) -> bool:
        """Resume, unless it was stopped again since `stops` were counted."""
        with self._wire:
            if self.stops != stops:
                return False
            self.held_by, self._full_s = "", -math.inf
            self.signal(RESUME)
            return True

    def begin(self, blocks: Iterable[Block], stops: int, *, homes: bool) -> None:
        """Send lines as there is room from now on; raises Refused after a stop."""
        with self._wire:
            if self.stops != stops:
                raise Refused(f"{self.name}: held or aborted before it began")
            self._load(blocks)
            self.error, self.is_homing = "", homes

    def unload(self) -> None:
        """Send no more lines of an ended motion; pending replies stay expected."""
        with self._wire:
            self._feed.discard_rest()
            self.held_by = ""

    def poll(self) -> Report:
        """Query the state, process the replies so far, send what fits now.

        GRBL answers no query while it homes, nor after an alarm of a limit: then the
        last position is reported. If it is idle with lines left, its queue has run
        empty, or it has restarted: then nothing is sent, except by `refill`.
        """
        self._feeds_until_s = host_clock.now_s() + _FEEDS_S
        glance_s = host_clock.now_s() + _GLANCE_S
        while self._process_line(glance_s):
            pass
        if self.is_homing and not self.held_by:
            self._report = replace(self._report, state="Home")
            return self._report
        if self.is_homing:
            self._await_restart(self._reply_s)  # a `?` in a reset is lost
        report = self._query_report()
        is_starved = not (self.is_sent or self._feed.unanswered or self._may_be_idle)
        self.starved_polls = (
            self.starved_polls + 1 if is_starved and report.state == "Idle" else 0
        )
        if self.starved_polls == 1:
            self._starved_since_s = host_clock.now_s()
        return report if self.starved_polls else self._fill(report)

    def refill(self) -> bool:
        """Send more to an empty queue; not if this poll took too long."""
        if host_clock.now_s() > self._feeds_until_s:
            return False
        self.starved_polls = 0
        self._fill(self._report)
        return True

    def feed(self) -> bool:
        """Send what fits, never a line twice; true if anything was sent."""
        with self._wire:
            if self.held_by or self.error or self._is_silent:
                return False
            blocks = self._feed.take()
            for block in blocks:
                self._may_be_idle = block.is_barrier
                self.sent_to = block.end or self.sent_to
            if blocks:
                self.restart_patience()
                self.error = "a line was cut off on its way"
                self._link.send(b"".join(block.text for block in blocks), end=b"")
                self.error = ""
            return bool(blocks)

    def restart_patience(self) -> None:
        """Restart the timeout of replies: it moves, or is held."""
        self._changed_s = host_clock.now_s()

    def command(self, text: str) -> list[bytes]:
        """Execute one line and return GRBL's messages. Raises Refused."""
        self._messages.clear()
        self._load([Block(f"{text}\n".encode())])
        self.error = ""
        self.feed()
        deadline_s = host_clock.now_s() + self._reply_s
        while self._feed.unanswered:
            if not self._process_line(deadline_s):
                raise DeviceTimeout(f"{self.name}: no answer to {text}")
        if self.error:
            raise Refused(f"{self.name}: {self.error}")
        if self.has_restarted:
            raise ConnectionLost(f"{self.name}: GRBL began anew at {text}; try again")
        return list(self._messages)

    def restart(self) -> Report:
        """Reset a machine at rest, which discards its lines.

        The reset also clears a lowered override, which is lowered again.
        """
        homed, override = self.is_homed, self.override
        self.has_restarted = False
        self.signal(RESET)
        self._await_restart(self._open_s)
        report, self.has_restarted = self._query_report(), False
        self.is_homed = None if report.state == "Alarm" else homed
        if override is not None:
            for _ in range(_STEPS_DOWN):
                self._query_report()
                self._query_report()
                if self.lower(override):
                    break
        return report

    def lower(self, most: float) -> bool:
        """Lower the override by a step if it is above; true if it is not.

        A change is reported in the second report at the latest.
        """
        if self.override is None or self.override <= most:
            return self.override is not None
        self.signal(TEN_LESS if self.override - most >= 0.1 else ONE_LESS)
        return False

    def explain_alarm(self) -> str:
        return f"ALARM:{self.alarm}, {ALARMS.get(self.alarm, 'unknown to GRBL 1.1')}"

    def _discard_old(self) -> None:
        self._messages: deque[bytes] = deque(maxlen=200)
        self._report, self._is_new = Report("", (0.0, 0.0, 0.0)), False
        self._late, self._is_silent = 0, False
        self.is_homing = self.has_restarted = False
        self.override: float | None = None
        self.is_homed: bool | None = None
        self.alarm, self.error = 0, ""
        self._load(())

    def _load(self, blocks: Iterable[Block]) -> None:
        room = self.settings.buffer_bytes if self.settings else 128
        self._feed = LineFeed(blocks, room)
        self._changed_s = host_clock.now_s()
        self.held_by, self._may_be_idle = "", True
        self.rows = self.starved_polls = 0
        self.sent_to: tuple[float, ...] = ()
        self._full_s = self._starved_since_s = self._feeds_until_s = -math.inf
        self._is_hastened = False  # the override was raised: sent lines last shorter

    def _await_restart(self, within_s: float) -> None:
        deadline_s = host_clock.now_s() + within_s
        while not self.has_restarted:
            if not self._process_line(deadline_s):
                raise DeviceTimeout(f"{self.name}: does not come back after a reset")

    def _send_hold(self) -> None:
        if self.is_homing:
            self.signal(RESET)
        else:  # on its way back from a door GRBL hears no `!`
            is_at_door = self._report.state.startswith("Door")
            self.signal(HOLD + DOOR if is_at_door else HOLD)

    def _fill(self, report: Report) -> Report:
        while report.state in ("Idle", "Run") and not self.is_done:
            if host_clock.now_s() > self._feeds_until_s:
                break
            is_fed, owed = self.feed(), len(self._feed.unanswered)
            report = self._query_report()
            unanswered = self._feed.unanswered
            if not is_fed and len(unanswered) >= owed:  # nor did a reply make room
                is_read = not unanswered or unanswered[0].is_barrier
                if not (is_read or self._is_hastened):  # two answers after it was sent
                    self._full_s = host_clock.now_s()
                break
        return report

    def _query_report(self) -> Report:
        deadline_s = host_clock.now_s() + self._reply_s
        while True:
            self._is_new = False
            if not self._is_silent:
                self.signal(ASK)
            while not self._is_new and not self._is_silent:
                if not self._process_line(deadline_s):
                    self._late = min(self._late + 1, _MOST_LATE)
                    raise DeviceTimeout(
                        f"{self.name}: GRBL does not answer; it drives what it has, a "
                        "second or so, and stands then. Is the cable plugged in?"
                    )
            if self._is_silent or not self._late:
                break
            self._late -= 1  # this one may answer an earlier query
        self._late = 0
        if self._is_silent:
            self._report = replace(self._report, state="Alarm")
        return self._report

    def _process_line(self, deadline_s: float) -> bool:
        line = self._link.receive(deadline_s)
        if line is None:
            return False
        if line == b"ok" or line.startswith(b"error:"):
            self._process_answer(line)
        elif line.startswith(b"ALARM:"):
            self.alarm, self.is_homed = _number(line), None
            if self.alarm in SILENT_ALARMS:
                self._is_silent, self.is_homing = True, False
        elif line.startswith(b"Grbl"):
            self.has_restarted = True
            self.is_homing = self._is_silent = False
            self.is_homed = self.override = None
            self._load(())
        elif report := parse_report(line):
            self._report, self._is_new = report, True
            if report.override is not None:
                if self.override is not None and report.override > self.override:
                    self._is_hastened, self._full_s = True, -math.inf
                self.override = report.override
            if report.state != "Alarm":
                self.alarm = 0
        else:
            self._messages.append(line)
        return True

    def _process_answer(self, line: bytes) -> None:
        if (block := self._feed.answer()) is None:
            log.warning("%s: GRBL answers what was not asked", self.name)
            return
        self._is_hastened &= not block.is_barrier
        self.restart_patience()
        if line == b"ok":
            self.rows += block.ends_row
            self.is_homed = True if self.is_homing else self.is_homed
        else:
            code, text = _number(line), block.text.decode().strip()
            self.error = f"error:{code} at {text}, {ERRORS.get(code, 'not taken')}"
        self.is_homing = False

    def _bring_to_rest(self) -> None:
        """The port is exclusive: a motion is one of an earlier client."""
        begin_s = host_clock.now_s()
        while (now_s := host_clock.now_s()) < begin_s + self._open_s:
            self._is_new = False
            self.signal(ASK)
            while not self._is_new and self._process_line(now_s + _ASK_AGAIN_S):
                pass
            if (
                self._is_new
                and self._report.is_at_rest
                and self._report.state != "Idle"
            ):
                return
            if self._is_new:
                self.signal(HOLD)  # an idle one may dwell, with lines behind it
                host_clock.sleep_s(_POLL_S)
            elif self._is_silent or now_s > begin_s + self._open_s / 2:
                self.signal(RESET)  # it homes, or a limit has stopped it
                host_clock.sleep_s(_ASK_AGAIN_S)
        if self._report.state:
            log.warning("%s: GRBL does not obey a hold; it is reset", self.name)
        elif self._link.has_received:
            raise WrongDevice(
                f"{self.name}: something answers, but not as GRBL 1.1 does; check "
                "baudrate and port, and whether $10=1"
            )
        else:
            raise DeviceTimeout(
                f"{self.name}: nothing answers; check port, cable and power of the "
                "control"
            )


def _number(line: bytes) -> int:
    digits = line.partition(b":")[2].strip()
    return int(digits) if digits.isdigit() else 0
