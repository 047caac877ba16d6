"""A motion of GRBL from its begin to its end. The caller locks."""

from __future__ import annotations

import logging
from collections.abc import Iterable

import numpy as np

from truepath_drivers import host_clock
from truepath_drivers.cnc.grbl.program import Block, write_blocks
from truepath_drivers.cnc.grbl.protocol import HOLD, RESET, RESUME, Report
from truepath_drivers.cnc.grbl.session import GrblSession
from truepath_drivers.interfaces.errors import MotionFault, Refused
from truepath_drivers.interfaces.records import (
    HELD_BY_PERSON,
    UNABLE,
    MotionState,
    MotionStatus,
    Path,
)

log = logging.getLogger(__name__)

_SILENT_S = 1.5  # a machine that stands has answered by then
_STOP_S = 1.0
_UNASKED_S = 1.0  # after so long a motion does not go on by itself
_WE = "command"
_LOOK_S = 0.02
_ROUNDED_MM = 2e-3  # of a report, beside a step of the motor


class GrblMotion:
    """The one motion that is under way, or the last one.

    loaded : the path that `begin` may run
    aborts : counts those asked for, by any thread
    """

    def __init__(self, session: GrblSession) -> None:
        self._session = session
        self._driven: Path | None = None
        self._ended = MotionState.IDLE
        self._line, self._text = 0, ""
        self._starts = 0
        self._is_stopping = self.is_under_way = False
        self._held_by = HELD_BY_PERSON
        self._looked_s = 0.0
        self.loaded: Path | None = None
        self.aborts = 0

    def forget(self) -> None:
        """Know that the link was opened anew: what was under way has ended."""
        self._starts = self._session.starts
        self._is_stopping = False
        if self.is_under_way:
            self._end(MotionState.ABORTED, "the connection was lost in motion")

    def take(self, path: Path) -> None:
        """Know that a path is loaded."""
        self.loaded, self._ended = path, MotionState.READY
        self._line, self._text = 0, ""

    def look(self) -> MotionStatus:
        """Read the machine, feed it, and draw what it means for our motion.

        A motion for which nobody has asked in a second is held.
        """
        now_s, before_s = host_clock.now_s(), self._looked_s
        if self.is_under_way and now_s - before_s > _UNASKED_S and self._held_by != _WE:
            self._held_by = "watchdog"
            self._session.signal(HOLD)
        self._looked_s = now_s
        report = self._session.look()
        if self._session.starts != self._starts:
            self._starts = self._session.starts
            self._is_stopping = False
            if self.is_under_way:
                self._end(MotionState.ABORTED, "GRBL has begun anew in the motion")
        was_stopping = self._is_stopping
        if self.is_under_way or was_stopping:
            self._follow(report)
        if was_stopping and not self._is_stopping:
            report = self._session.look()  # it has begun anew meanwhile
        return self._judge(report)

    def require_able(self, status: MotionStatus) -> None:
        """Raise MotionFault where the machine cannot be driven."""
        if status.state in UNABLE:
            raise MotionFault(f"{self._session.name}: {status.alarm}")

    def begin(self, path: Path, aborts: int) -> None:
        """Have a path begin from where the machine stands."""
        status = self.look()
        self.require_able(status)
        self._require_standing(status)
        settings = self._session.settings
        if self.aborts != aborts or settings is None:
            raise Refused("aborted before it began")
        self._driven = path
        self._go(write_blocks(path, status.position, settings))
        if self.aborts != aborts:  # its hold may have come before the first line
            self.stop()

    def home(self) -> None:
        """Have the machine home."""
        self._require_standing(self.look())
        self._driven = None
        self._go([Block(b"$H\n")], homes=True)

    def _require_standing(self, status: MotionStatus) -> None:
        if status.state in (MotionState.RUNNING, MotionState.HELD):
            raise Refused(f"{self._session.name}: not in state {status.state}")

    def _go(self, blocks: Iterable[Block], *, homes: bool = False) -> None:
        self._line, self._text, self._held_by = 0, "", HELD_BY_PERSON
        self.is_under_way, self._ended = True, MotionState.IDLE
        self._session.begin(blocks, homes=homes)

    def hold(self) -> None:
        """Feed hold; without a lock where something of ours is under way."""
        self._held_by = _WE
        self._session.signal(HOLD)

    def brake(self) -> None:
        """Let an abort begin; without a lock as well."""
        self._is_stopping = True
        self._session.signal(HOLD)

    def resume(self) -> None:
        """Go on after a hold; return when it does."""
        deadline_s = host_clock.now_s() + _STOP_S
        while self.look().state is MotionState.HELD:
            if host_clock.now_s() > deadline_s:
                raise MotionFault(f"{self._session.name} does not go on; try again")
            self._held_by = HELD_BY_PERSON
            self._session.signal(RESUME)
            host_clock.sleep_s(_LOOK_S)

    def stop(self) -> None:
        """Brake, then drop what GRBL has; what is not over in a second goes on later.

        A reset in motion would lose the position, so it comes at the standstill.
        """
        self.loaded = None
        if self._session.is_homing:
            self._session.signal(RESET)  # homing hears nothing else
            self._end(MotionState.ABORTED)
            return
        if not self.is_under_way and self._session.look().stands:
            self._end(MotionState.ABORTED)
            return
        self.brake()
        deadline_s = host_clock.now_s() + _STOP_S
        while self.look().state is MotionState.RUNNING:
            if host_clock.now_s() > deadline_s:
                return
            host_clock.sleep_s(_LOOK_S)

    def reset(self) -> None:
        """Clear an alarm; without homing, unlock."""
        self._require_standing(self.look())
        self._session.halt()
        self._session.alarm = 0
        report = self._session.look()
        homes = self._session.settings is not None and self._session.settings.homes
        if report.state == "Alarm" and not homes:
            self._session.command("$X")

    def wait_until_homed(self) -> bool:
        """Tell whether homing is over. Raises MotionFault where it has failed."""
        status = self.look()
        if self._session.is_homing:
            return False
        self.require_able(status)
        if status.state is MotionState.ABORTED:
            raise MotionFault(f"{self._session.name} does not home: {self._text}")
        return True

    def _follow(self, report: Report) -> None:
        session, stream = self._session, self._session.stream
        if self._driven is not None:
            self._line = min(stream.rows, len(self._driven) - 1)
        if session.error and not self._is_stopping:
            self._text = session.error
            self.brake()
            return
        if report.state != "Idle":
            stream.touch()
        if report.state == "Alarm":
            self._end(MotionState.ABORTED)
        elif self._is_stopping:
            if report.state in ("Hold", "Door") and report.stands:
                session.halt()
                self._end(MotionState.ABORTED, self._text)
        elif report.state != "Idle":
            return
        elif stream.is_done:
            self._arrive(report)
        elif stream.measure_silence_s() > _SILENT_S:
            if stream.is_sent and self._is_at_goal(report):
                log.warning("%s: a reply of GRBL was lost", session.name)
                self._arrive(report)
                return
            self._text = "GRBL stands and owes replies: lines or replies were lost"
            self.brake()

    def _arrive(self, report: Report) -> None:
        if self._driven is not None:
            self._line = len(self._driven) - 1
        arrived = self._is_at_goal(report)
        text = "" if arrived else "GRBL stands where the motion does not end"
        self._end(MotionState.FINISHED if arrived else MotionState.ABORTED, text)

    def _is_at_goal(self, report: Report) -> bool:
        settings = self._session.settings
        if self._driven is None or settings is None:
            return True
        off = np.abs(self._driven.position[-1] - self._session.position(report))
        return bool((off <= settings.step_mm + _ROUNDED_MM).all())

    def _end(self, state: MotionState, text: str = "") -> None:
        self.is_under_way = self._is_stopping = False
        self._ended, self._text = state, text

    def _judge(self, report: Report) -> MotionStatus:
        state, text, reason = self._ended, self._text, ""
        if report.state in ("Alarm", "Sleep", "Check") or (
            report.state == "Door" and report.part
        ):
            state, text = self._find_hindrance(report)
        elif self._is_stopping or not report.stands:
            state = MotionState.RUNNING
        elif report.state in ("Hold", "Door"):
            state = MotionState.HELD
            reason = "door" if report.state == "Door" else self._held_by
        elif self.is_under_way:
            state = MotionState.RUNNING
        return MotionStatus(
            state,
            self._session.position(report),
            self._line,
            text,
            reason,
            self._session.override,
            self._tell_referenced(state),
            compensation=False,
        )

    def _find_hindrance(self, report: Report) -> tuple[MotionState, str]:
        if report.state == "Alarm" and self._session.alarm:
            return MotionState.ALARM, self._session.explain_alarm()
        settings = self._session.settings
        if report.state == "Alarm":
            homes = settings is not None and settings.homes
            state = MotionState.UNHOMED if homes else MotionState.ALARM
        else:
            door = report.state == "Door"
            state = MotionState.DOOR if door else MotionState.NOT_READY
        return state, str(UNABLE[state])

    def _tell_referenced(self, state: MotionState) -> bool | None:
        settings = self._session.settings
        if state is MotionState.UNHOMED or (settings and not settings.homes):
            return False
        return self._session.is_homed
