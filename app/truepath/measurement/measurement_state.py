"""State of one measurement, and the reasons to hold the feed. For any thread.

Verbs are absolute and idempotent. The machine may move only while there is no reason to
hold. A hold that has begun is completed: the machine stops before it resumes, so that a
late hold never overtakes the resume after it.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from enum import StrEnum

from truepath.measurement.messages import CellState
from truepath_drivers.interfaces.records import MotionState

_S = CellState
ENDS = frozenset({_S.FINISHED, _S.ABORTED, _S.FAILED, _S.FAULTED})
TRANSITIONS: dict[CellState, frozenset[CellState]] = {
    _S.RUNNING: frozenset({_S.PAUSING, _S.PAUSED}) | ENDS,
    _S.PAUSING: frozenset({_S.PAUSED}) | ENDS,
    _S.PAUSED: frozenset({_S.RESUMING, _S.RUNNING}) | ENDS,
    _S.RESUMING: frozenset({_S.RUNNING, _S.PAUSING, _S.PAUSED}) | ENDS,
}


class HoldReason(StrEnum):
    """Reason for which the service holds the machine."""

    OPERATOR = "operator"
    SILENCE = "silence"
    DAMAGE = "damage"
    BEAM = "beam"
    POSITION = "position"  # of the axes: not to be believed
    PLACE = "place"  # of the target, likewise
    TARGET = "target"
    DISK = "disk"
    DISK_STAYED_SLOW = "disk-stayed-slow"  # for a person to release
    CONTROL = "control"  # it does not answer, or that it is busy
    SERVICE = "service"  # it could not stop the machine
    MACHINE = "machine"  # held by panel, door or watchdog: for a person to release


# Reasons that a controller reports for a hold by the service.
_OWN_HOLDS = frozenset({"", "command"})


class MeasurementState:
    """State and hold reasons.

    changed : receives every new state with a text, in the thread that caused it
    holds : reasons in force
    """

    def __init__(self, changed: Callable[[CellState, str], None]) -> None:
        self._changed = changed
        self._lock = threading.RLock()
        self.state = CellState.RUNNING
        self.holds: set[HoldReason] = set()
        self._may_release_machine = False
        self.aborted = threading.Event()

    @property
    def requires_standstill(self) -> bool:
        """Whether the machine must not be moved now."""
        return self.state is not CellState.RUNNING

    @property
    def wants_hold(self) -> bool:
        """Whether the machine has to be held where it moves."""
        return self.state in (CellState.PAUSING, CellState.PAUSED)

    def hold(self, reason: HoldReason, text: str) -> bool:
        """Request a hold; true if it is a new one."""
        with self._lock:
            if reason in self.holds or self.state in ENDS:
                return False
            self.holds.add(reason)
            if self.state in (CellState.RUNNING, CellState.RESUMING):
                self._enter(CellState.PAUSING, text)
            return True

    def release(self, *reasons: HoldReason, text: str) -> None:
        """Withdraw these reasons to hold.

        Only with MACHINE among them is the machine's own hold released too.
        """
        with self._lock:
            self.holds -= set(reasons)
            self._may_release_machine = HoldReason.MACHINE in reasons
            if not self.holds and self.state is CellState.PAUSED:
                self._enter(CellState.RESUMING, text)

    def observe(self, motion: MotionState, hold_reason: str) -> None:
        """Compare the reasons with the controller's state, and change the state."""
        with self._lock:
            held = motion is MotionState.HELD
            running = motion is MotionState.RUNNING
            if running:
                self.holds.discard(HoldReason.MACHINE)
            elif held and self._is_external_hold(hold_reason):
                self._hold_by_machine(f"held at the machine: {hold_reason}")
            if self.state is CellState.PAUSING and not running:
                self._enter(CellState.PAUSED, "")
            if self.state is CellState.PAUSED and not self.holds:
                if running:
                    self._enter(CellState.RUNNING, "released at the machine")
                else:
                    self._enter(CellState.RESUMING, "no reason to stand any more")
            if self.state is CellState.RESUMING and not held:
                self._enter(CellState.RUNNING, "")

    def fall_back(self, text: str) -> None:
        """Give up a resume: the controller keeps holding."""
        with self._lock:
            if self.state is CellState.RESUMING:
                self._hold_by_machine(text)

    def end(self, state: CellState, text: str) -> None:
        """Enter a final state."""
        with self._lock:
            self._enter(state, text)

    def _is_external_hold(self, hold_reason: str) -> bool:
        if self.state is CellState.RUNNING:
            return True
        # A resume by an operator overrides the hold still reported for a moment.
        asked = self.state is CellState.RESUMING and self._may_release_machine
        return hold_reason not in _OWN_HOLDS and not asked

    def _hold_by_machine(self, text: str) -> None:
        self.holds.add(HoldReason.MACHINE)
        if self.state in (CellState.RUNNING, CellState.RESUMING):
            self._enter(CellState.PAUSED, text)

    def _enter(self, state: CellState, text: str) -> None:
        if state not in TRANSITIONS.get(self.state, frozenset()):
            raise ValueError(f"no way from {self.state} to {state}")
        self.state = state
        self._changed(state, text)
