"""What a driver remembers of its motion: linuxcncrsh tells neither path nor outcome."""

from __future__ import annotations

from dataclasses import dataclass, replace

from truepath.drivers.cnc.linuxcnc.program import Program
from truepath.drivers.cnc.linuxcnc.readings import Reading
from truepath.drivers.interfaces.records import UNABLE, MotionState, MotionStatus

_ARRIVED = 1e-3  # mm or deg


@dataclass(slots=True)
class MotionMemory:
    """The path that is loaded and the motion that was begun last.

    ended : the state while nothing moves
    begun_at : where the machine stood before the motion
    text : what LinuxCNC said at the end of the motion
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
        """Return the memory as a motion begins at a position."""
        return MotionMemory(self.loaded, program, self.ended, True, position)

    def end_refused(self) -> MotionMemory:
        """Return the memory of a motion that did not begin."""
        return replace(self, driven=None, is_under_way=False)

    def has_moved(self, look: Reading) -> bool:
        """Tell whether the machine has left where the motion began."""
        pairs = zip(look.position, self.begun_at, strict=True)
        return any(abs(now - then) > _ARRIVED for now, then in pairs)

    def is_at_goal(self, look: Reading) -> bool:
        """Tell whether the machine is where the motion ends."""
        if self.driven is None:
            return False
        pairs = zip(look.position, self.driven.goal, strict=True)
        return all(abs(now - goal) <= _ARRIVED for now, goal in pairs)

    def judge(self, look: Reading) -> MotionStatus:
        """Return the status that a look amounts to, and remember an end."""
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
