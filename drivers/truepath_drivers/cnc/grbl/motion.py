"""One motion of GRBL from begin to end. The caller locks."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Iterable, Sequence

import numpy as np

from truepath_drivers import host_clock
from truepath_drivers.cnc.grbl.protocol import Block, Report, Settings, write_blocks
from truepath_drivers.cnc.grbl.session import GrblSession
from truepath_drivers.interfaces.errors import DeviceTimeout, MotionFault, Refused
from truepath_drivers.interfaces.records import (
    HELD_BY_PERSON,
    UNABLE,
    MotionState,
    MotionStatus,
    Path,
)
from truepath_drivers.interfaces.tracker_records import TrackerEvent, TrackerEventKind

log = logging.getLogger(__name__)

_SILENT_S = 1.5  # a machine at rest has answered within this time
_STOP_S = 2.0  # longest braking, by the size of the pieces of a path
_DISOBEYS_S = 1.0  # within which a hold takes effect
_UNASKED_S = 1.0  # longest motion without a request for the status
_POLL_S = 0.02
_ROUNDED_MM = 2e-3  # of a report, in addition to a step of the motor
_UNEVEN = (
    "the axes stood within a row for a moment, which was not driven at one feed: this "
    "computer was too slow to send it in time"
)


class GrblMotion:
    """The active motion, or the last one.

    loaded : the path that `start` may run
    is_stopping : it brakes, and a reset discards it once the axes are at rest
    events : the last ones not yet taken
    """

    def __init__(self, session: GrblSession) -> None:
        self._session = session
        self._path: Path | None = None
        self._ended, self._stops_as = MotionState.IDLE, MotionState.ABORTED
        self._line, self._uneven_line, self._text = 0, -1, ""
        self.events: deque[TrackerEvent] = deque(maxlen=100)
        self._polled_s = self._polled_wall_s = self._obeyed_s = 0.0
        self.is_under_way = self.is_stopping = False
        self.loaded: Path | None = None

    def note_reconnection(self) -> None:
        """End an active motion: the link was opened again."""
        if self.is_under_way or self.is_stopping:
            self._end(MotionState.ABORTED, "the connection was lost in motion")

    def store(self, path: Path) -> None:
        self._require_still(self.poll())
        self.loaded, self._ended = path, MotionState.READY
        self._line, self._text = 0, ""

    def poll(self) -> MotionStatus:
        """Read the machine, feed it, and update the state of the motion.

        A motion that was not polled for a second, or got no answer, is held. The wall
        clock advances while the computer sleeps.
        """
        session = self._session
        now_s, wall_s = host_clock.now_s(), host_clock.wall_s()
        away_s = max(now_s - self._polled_s, wall_s - self._polled_wall_s)
        is_fed = self.is_under_way and not (session.is_homing or session.held_by)
        if is_fed and away_s > _UNASKED_S:
            session.brake("watchdog")
        try:
            report = session.poll()
        except DeviceTimeout:
            if session.held_by and (self.is_under_way or self.is_stopping):
                session.repeat_hold()  # the first may have been lost as well
            raise
        self._polled_s, self._polled_wall_s = now_s, wall_s
        if session.has_restarted:
            session.has_restarted = False
            if self.is_under_way or self.is_stopping:
                self._end(MotionState.ABORTED, "GRBL has begun anew in the motion")
        if self.is_under_way or self.is_stopping:
            report = self._follow(report)
        return self._assess(report)

    def require_able(self, status: MotionStatus) -> None:
        if status.state in UNABLE:
            raise MotionFault(f"{self._session.name}: {status.alarm}")

    def begin(self, path: Path, stops: int) -> None:
        """Start a path from the present position."""
        status, session = self.poll(), self._session
        self.require_able(status)
        blocks = write_blocks(
            path, status.position, self._settings, lambda: session.override or 1.0
        )
        self._go(status, path, blocks, stops)

    def home(self, stops: int) -> None:
        """Start homing, also from an alarm."""
        self._require_still(self.poll())
        self._session.restart()
        status = self.poll()
        if status.state is MotionState.DOOR:
            self.require_able(status)
        self._go(status, None, [Block(b"$H\n")], stops)

    def resume(self, stops: int) -> None:
        """Resume after a hold, unless it was stopped again; wait until it moves."""
        session, deadline_s = self._session, host_clock.now_s() + _STOP_S
        state = self.poll().state
        while not self.is_stopping and (
            state is MotionState.HELD
            or (state is MotionState.RUNNING and session.held_by)
        ):
            if host_clock.now_s() > deadline_s:
                session.brake(session.held_by or "command")
                raise MotionFault(f"{session.name} does not go on; try again")
            if state is MotionState.HELD and not session.release(stops):
                return
            host_clock.sleep_s(_POLL_S)
            state = self.poll().state

    def brake(self, text: str = "", ends_as: MotionState = MotionState.ABORTED) -> None:
        self._text, self._stops_as = text, ends_as
        self._obeyed_s = host_clock.now_s()
        self.is_stopping = True
        self._session.brake("command")

    def stop(self) -> None:
        """Brake, then discard GRBL's lines; after 2 s this continues in `poll`.

        A reset in motion would lose the position, so it is sent at standstill.
        """
        self.loaded = None
        if self.is_under_way and not self.is_stopping:
            self.brake()
        state = self.poll().state
        moves = state in (MotionState.RUNNING, MotionState.HELD)
        if not moves and not self.is_under_way:
            self._end(MotionState.ABORTED)
        elif not self.is_stopping:
            self.brake()
        deadline_s = host_clock.now_s() + _STOP_S
        while self.is_stopping and host_clock.now_s() <= deadline_s:
            host_clock.sleep_s(_POLL_S)
            self.poll()

    def stop_own_motion(self) -> None:
        """Stop a motion; a hold by the operator stays."""
        self._session.count_stop()
        if self.is_under_way or self.poll().state is MotionState.RUNNING:
            self.stop()

    def reset(self) -> None:
        """Clear an alarm and end the motion; unlock a machine without homing."""
        try:
            self._require_still(self.poll())
        except DeviceTimeout as error:  # it does not answer after some alarms
            log.warning("%s", error)
        report = self._session.restart()
        self._session.alarm = 0
        if self.is_under_way or self.is_stopping:
            self._end(MotionState.ABORTED)
        if report.state == "Alarm" and not self._settings.homes:
            self._session.command("$X")

    @property
    def _settings(self) -> Settings:
        if self._session.settings is None:
            raise Refused(f"{self._session.name} is not connected")
        return self._session.settings

    def _require_still(self, status: MotionStatus) -> None:
        if status.state in (MotionState.RUNNING, MotionState.HELD):
            raise Refused(f"{self._session.name}: not in state {status.state}")

    def _go(
        self,
        status: MotionStatus,
        path: Path | None,
        blocks: Iterable[Block],
        stops: int,
    ) -> None:
        self._require_still(status)
        if not self._session.is_done:
            raise Refused(f"{self._session.name}: GRBL owes a reply; reset it")
        self._session.begin(blocks, stops, homes=path is None)
        self._path, self._text = path, ""
        self._line, self._uneven_line = 0, -1
        self.is_under_way, self._ended = True, MotionState.IDLE
        self._session.feed()

    def _follow(self, report: Report) -> Report:
        session = self._session
        if self._path is not None:
            self._line = min(session.rows, len(self._path) - 1)
        if report.state == "Alarm":
            self._end(MotionState.ABORTED, session.error)
        elif session.error and not self.is_stopping:
            self.brake(session.error)
        elif self.is_stopping or session.held_by:
            return self._follow_stop(report)
        elif report.state != "Idle":
            session.restart_patience()
        elif session.is_done:
            at_goal = self._is_at_goal(report)
            text = "" if at_goal else "GRBL stands where the motion does not end"
            self._end(MotionState.FINISHED if at_goal else MotionState.ABORTED, text)
        elif session.starved_polls > 1:
            self._follow_starved(report)
        elif session.silence_s > _SILENT_S and not session.is_homing:
            self._stop_silent(report)
        return report

    def _follow_starved(self, report: Report) -> None:
        """Refill the queue only if this computer was slow for a moment."""
        session = self._session
        if not self._is_at(session.sent_to, report):
            self.brake("GRBL stands where no line ends: it has lost its queue")
        elif session.has_lost_time or session.starved_s > _UNASKED_S:
            session.brake("watchdog")
        elif session.refill() and self._line != self._uneven_line:
            self._uneven_line = self._line
            log.warning("%s: row %d: %s", session.name, self._line + 1, _UNEVEN)
            self.events.append(TrackerEvent(TrackerEventKind.UNEVEN, _UNEVEN))

    def _follow_stop(self, report: Report) -> Report:
        """Repeat the hold until it brakes; reset a stopped machine at standstill."""
        session = self._session
        session.restart_patience()
        if report.brakes:
            self._obeyed_s = host_clock.now_s()
        elif not session.is_homing:
            session.repeat_hold()
        late = host_clock.now_s() - self._obeyed_s > _DISOBEYS_S
        at_rest = report.is_at_rest and report.state != "Idle"
        if not self.is_stopping or not (at_rest or late):
            return report
        report = session.restart()
        self._end(self._stops_as, self._text)
        return report

    def _stop_silent(self, report: Report) -> None:
        """Replies or lines were lost: only a reset corrects the count."""
        if self._session.is_sent and self._is_at_goal(report):
            log.warning("%s: a reply of GRBL was lost", self._session.name)
            self.brake(ends_as=MotionState.FINISHED)
        else:
            self.brake("GRBL stands and owes replies: lines or replies were lost")

    def _is_at_goal(self, report: Report) -> bool:
        return self._path is None or self._is_at(self._path.position[-1], report)

    def _is_at(self, place: Sequence[float], report: Report) -> bool:
        off = np.abs(np.subtract(place, report.position))
        return bool((off <= self._settings.step_mm + _ROUNDED_MM).all())

    def _end(self, state: MotionState, text: str = "") -> None:
        self.is_under_way = self.is_stopping = self._session.is_homing = False
        self._ended, self._text = state, text
        self._session.unload()

    def _assess(self, report: Report) -> MotionStatus:
        state, text, reason = self._ended, self._text, ""
        if self.is_stopping or not report.is_at_rest:
            state = MotionState.RUNNING
        elif report.state in ("Alarm", "Sleep", "Check", "Door:1"):
            state, text = self._explain_state(report)
        elif report.state in ("Hold:0", "Door:0"):
            state = MotionState.HELD
            reason = self._session.held_by or HELD_BY_PERSON
        elif self.is_under_way:
            state = MotionState.RUNNING
        homes, homed = self._settings.homes, self._session.is_homed
        return MotionStatus(
            state,
            report.position,
            self._line,
            text,
            reason,
            self._session.override,
            homed if homes and state is not MotionState.UNHOMED else False,
            compensation=False,
        )

    def _explain_state(self, report: Report) -> tuple[MotionState, str]:
        if report.state == "Alarm" and self._session.alarm:
            return MotionState.ALARM, self._session.explain_alarm()
        if report.state == "Alarm":
            homes = self._settings.homes
            state = MotionState.UNHOMED if homes else MotionState.ALARM
        else:
            is_door = report.state == "Door:1"
            state = MotionState.DOOR if is_door else MotionState.NOT_READY
        return state, str(UNABLE[state])
