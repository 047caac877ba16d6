"""The state of one measurement, and the reasons to hold the feed. For any thread.

Verbs are absolute and idempotent. The machine may move only while there is no reason to
hold. A hold that has begun is completed: the machine stands before it goes on, so that
a late hold never overtakes the resume after it.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from enum import StrEnum

from app.measurement.messages import CellState
from drivers.interfaces.records import MotionState

_S = CellState
ENDS = frozenset({_S.FINISHED, _S.ABORTED, _S.FAILED, _S.FAULTED})
TRANSITIONS: dict[CellState, frozenset[CellState]] = {
    _S.RUNNING: frozenset({_S.PAUSING, _S.PAUSED}) | ENDS,
    _S.PAUSING: frozenset({_S.PAUSED}) | ENDS,
    _S.PAUSED: frozenset({_S.RESUMING, _S.RUNNING}) | ENDS,
    _S.RESUMING: frozenset({_S.RUNNING, _S.PAUSING, _S.PAUSED}) | ENDS,
}


class HoldReason(StrEnum):
    """Why the service wants the machine to stand."""

    OPERATOR = "operator"
    SILENCE = "silence"
    BEAM = "beam"
    DISK = "disk"
    MACHINE = "machine"  # held by panel, door or watchdog: for a person to release


# What a controller says of a hold that we have asked for.
_OWN_HOLDS = frozenset({"", "command"})


class MeasurementState:
    """State of one measurement.

    changed : receives every new state with a text, in the thread that caused it
    """

    def __init__(self, changed: Callable[[CellState, str], None]) -> None:
        self._changed = changed
        self._lock = threading.RLock()
        self._state = CellState.RUNNING
        self._holds: set[HoldReason] = set()
        self._may_release_machine = False
        self.aborted = threading.Event()

    @property
    def state(self) -> CellState:
        """The state now."""
        return self._state

    @property
    def must_stand(self) -> bool:
        """Whether the machine must not be moved now."""
        return self._state is not CellState.RUNNING

    @property
    def wants_hold(self) -> bool:
        """Whether the machine has to be held where it moves."""
        return self._state in (CellState.PAUSING, CellState.PAUSED)

    def holds(self, reason: HoldReason) -> bool:
        """Tell whether this is a reason to stand."""
        return reason in self._holds

    def hold(self, reason: HoldReason, text: str) -> bool:
        """Request a hold; tell whether it is a new one."""
        with self._lock:
            if reason in self._holds or self._state in ENDS:
                return False
            self._holds.add(reason)
            if self._state in (CellState.RUNNING, CellState.RESUMING):
                self._enter(CellState.PAUSING, text)
            return True

    def release(self, *reasons: HoldReason, text: str) -> None:
        """Give up these reasons to hold.

        Only who names the machine as well may undo a hold of its own.
        """
        with self._lock:
            self._holds -= set(reasons)
            self._may_release_machine = HoldReason.MACHINE in reasons
            if not self._holds and self._state is CellState.PAUSED:
                self._enter(CellState.RESUMING, text)

    def observe(self, motion: MotionState, hold_reason: str) -> None:
        """Compare the reasons with what the controller does, and change the state."""
        with self._lock:
            held = motion is MotionState.HELD
            running = motion is MotionState.RUNNING
            if running:
                self._holds.discard(HoldReason.MACHINE)
            elif held and self._is_external_hold(hold_reason):
                self._hold_by_machine(f"held at the machine: {hold_reason}")
            if self._state is CellState.PAUSING and not running:
                self._enter(CellState.PAUSED, "")
            if self._state is CellState.PAUSED and not self._holds:
                if running:
                    self._enter(CellState.RUNNING, "released at the machine")
                else:
                    self._enter(CellState.RESUMING, "no reason to stand any more")
            if self._state is CellState.RESUMING and not held:
                self._enter(CellState.RUNNING, "")

    def fall_back(self, text: str) -> None:
        """Give up resuming: the controller keeps holding."""
        with self._lock:
            if self._state is CellState.RESUMING:
                self._hold_by_machine(text)

    def end(self, state: CellState, text: str) -> None:
        """Enter a final state."""
        with self._lock:
            self._enter(state, text)

    def _is_external_hold(self, hold_reason: str) -> bool:
        """Tell whether a hold is none that we have asked for."""
        if self._state is CellState.RUNNING:
            return True
        # A person who resumes takes back what the machine still says for a moment.
        asked = self._state is CellState.RESUMING and self._may_release_machine
        return hold_reason not in _OWN_HOLDS and not asked

    def _hold_by_machine(self, text: str) -> None:
        self._holds.add(HoldReason.MACHINE)
        if self._state in (CellState.RUNNING, CellState.RESUMING):
            self._enter(CellState.PAUSED, text)

    def _enter(self, state: CellState, text: str) -> None:
        if state not in TRANSITIONS.get(self._state, frozenset()):
            raise ValueError(f"no way from {self._state} to {state}")
        self._state = state
        self._changed(state, text)
