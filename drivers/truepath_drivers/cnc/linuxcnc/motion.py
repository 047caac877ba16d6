"""A motion of LinuxCNC from its begin to its end, with its supervision."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace

from truepath_drivers import host_clock
from truepath_drivers.cnc.linuxcnc.program import Program
from truepath_drivers.cnc.linuxcnc.readings import Reading
from truepath_drivers.cnc.linuxcnc.session import TIP_IS_FOLLOWED, LinuxCncSession
from truepath_drivers.cnc.priority_lock import PriorityLock
from truepath_drivers.interfaces.errors import MotionFault, Refused
from truepath_drivers.interfaces.records import UNABLE, MotionState, MotionStatus

log = logging.getLogger(__name__)

_BEGIN_S = 0.3  # in which a motion shows, or is refused
_BEGIN_LOOK_S = 0.01


class LinuxCncMotion:
    """The active motion, or the last one. The caller locks.

    aborts : number of requests so far, by any thread
    """

    def __init__(self, session: LinuxCncSession, lock: PriorityLock) -> None:
        self._session, self._lock = session, lock
        self._memory = MotionMemory()
        self.aborts = 0

    @property
    def loaded(self) -> Program | None:
        """The path that `begin` may run."""
        return self._memory.loaded

    def take(self, program: Program) -> None:
        """Store the loaded program as the current one."""
        self._memory = MotionMemory(loaded=program, ended=MotionState.READY)

    def look(self) -> MotionStatus:
        """Read the machine, and update the state of the motion.

        Raises MotionFault, and aborts, where a motion differs from its rows.
        """
        look, machine = self._session.look(), self._session.machine
        was_under_way = self._memory.is_under_way
        has_compensation = machine.has_compensation if machine else None
        status = replace(self._memory.assess(look), compensation=has_compensation)
        if was_under_way and look.follows_tip and self._memory.has_moved(look):
            self.abort()
            raise MotionFault(f"{self._session.name}: {TIP_IS_FOLLOWED}")
        if was_under_way and not self._memory.is_under_way:
            self._session.disarm()
            errors = self._session.take_errors()
            self._memory.text = "; ".join(errors)
            for error in errors:
                log.warning("%s: %s", self._session.name, error)
            status = replace(status, alarm=status.alarm or self._memory.text)
        return status

    def prepare(self, mode: str) -> None:
        """Enter a mode with the machine ready and at rest."""
        status = self.look()
        self.require_able(status)
        if status.state in (MotionState.RUNNING, MotionState.HELD):
            raise Refused(f"{self._session.name}: not in state {status.state}")
        self._session.take_errors()
        self._session.enter_mode(mode)

    def begin(self, what: str, program: Program, aborts: int) -> None:
        """Start a motion, and confirm that it runs or has ended already. Locks."""
        with self._lock.hold():
            if self.aborts != aborts:
                raise Refused("aborted before it began")
            before = self._session.look().position
            self._session.arm()
            try:
                self._session.demand(what)
            except Refused:
                self._session.disarm()
                raise
            self._memory = self._memory.begin(program, before)
        deadline_s = host_clock.now_s() + _BEGIN_S
        while self.aborts == aborts and host_clock.now_s() < deadline_s:
            with self._lock.hold():
                look, errors = self._session.look(), self._session.take_errors()
                if errors and self.aborts == aborts:
                    self._memory = self._memory.end_refused()
                    self._session.disarm()
                    raise Refused(f"{self._session.name}: {'; '.join(errors)}")
                if self._memory.has_moved(look) or look.has_ended:
                    return
            host_clock.sleep_s(_BEGIN_LOOK_S)

    def hold(self) -> None:
        """Feed hold, if anything runs."""
        if self._session.is_running():
            self._memory.is_held_by_us = True
            self._session.insist("pause")

    def resume(self) -> None:
        """Resume after a hold; no action if nothing is held."""
        if self.look().state is not MotionState.HELD:
            return
        self._session.arm()
        self._memory.is_held_by_us = False
        if not self._session.is_running():  # after the watchdog alone it does
            self._session.demand("resume")

    def abort(self) -> None:
        """Stop and discard the path."""
        self._session.insist("abort")
        self._memory = MotionMemory(ended=MotionState.ABORTED)
        self._session.disarm()

    def require_able(self, status: MotionStatus) -> None:
        """Raise MotionFault in the states of `UNABLE`."""
        if status.state in UNABLE:
            raise MotionFault(f"{self._session.name}: {UNABLE[status.state]}")


_ARRIVED = 1e-3  # mm or deg


@dataclass(slots=True)
class MotionMemory:
    """The loaded path and the motion that was begun last.

    ended : the state while nothing moves
    begun_at : axis positions before the motion
    text : message of LinuxCNC at the end of the motion
    """

    loaded: Program | None = None
    driven: Program | None = None
    ended: MotionState = MotionState.IDLE
    is_under_way: bool = False
    begun_at: tuple[float, ...] = ()
    is_held_by_us: bool = False
    line: int = 0
    text: str = ""

    def begin(self, program: Program, position: tuple[float, ...]) -> MotionMemory:
        """The memory at the begin of a motion from a position."""
        return MotionMemory(self.loaded, program, self.ended, True, position)

    def end_refused(self) -> MotionMemory:
        """The memory of a motion that did not begin."""
        return replace(self, driven=None, is_under_way=False)

    def has_moved(self, look: Reading) -> bool:
        """Whether any axis has left its position at the begin."""
        pairs = zip(look.position, self.begun_at, strict=True)
        return any(abs(now - then) > _ARRIVED for now, then in pairs)

    def is_at_goal(self, look: Reading) -> bool:
        """Whether all axes are at the end of the motion."""
        if self.driven is None:
            return False
        pairs = zip(look.position, self.driven.goal, strict=True)
        return all(abs(now - goal) <= _ARRIVED for now, goal in pairs)

    def assess(self, look: Reading) -> MotionStatus:
        """Status of a reading; stores the end of a motion."""
        moves = not look.stands and look.unable is None
        is_held = look.is_paused or (look.is_busy and look.is_tripped)
        if self.driven is not None and (look.is_busy or look.is_paused):
            self.line = self.driven.find_row(look.line)
        if self.is_under_way and not moves and not is_held:
            self.is_under_way = False
            arrived = look.unable is None and self.is_at_goal(look)
            self.ended = MotionState.FINISHED if arrived else MotionState.ABORTED
        state, text, reason = self.ended, self.text, ""
        if look.unable is not None:
            state, text = look.unable, self.text or str(UNABLE[look.unable])
        elif moves:
            state = MotionState.RUNNING
        elif is_held:
            state, reason = MotionState.HELD, self._find_hold_reason(look)
        return MotionStatus(
            state,
            look.position,
            self.line,
            text,
            reason,
            look.override,
            look.referenced,
        )

    def _find_hold_reason(self, look: Reading) -> str:
        if look.is_tripped:
            told = f", because {look.dead} of LinuxCNC does not run"
            return "watchdog" + (told if look.dead else "")
        return "command" if self.is_held_by_us else "operator"
