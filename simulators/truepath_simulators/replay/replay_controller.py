"""A controller that repeats a recorded one, if its host gives the same orders."""

from __future__ import annotations

import numpy as np

from truepath_drivers.cnc.modbus.registers import HoldReason, Result
from truepath_drivers.interfaces.records import MotionState
from truepath_simulators.cnc.cnc_controller import Controller
from truepath_simulators.machine_file import MachineFile
from truepath_simulators.motion.profile import Limits
from truepath_simulators.motion.program import Program
from truepath_simulators.replay.recorded_run import RecordedRun
from truepath_simulators.replay.replay_clock import ReplayClock

_SAME = 0.02  # mm or deg between an ordered and a recorded end
_AHEAD = 4  # rows that a machine passes between two looks, at most


class ReplayController(Controller):
    """Positions of the recording. All times are those of the replay.

    A motion after the last recorded one is refused; moves without a stream are
    immediate.
    """

    def __init__(
        self, machine: MachineFile, run: RecordedRun, clock: ReplayClock
    ) -> None:
        super().__init__(machine, Limits(), lambda _: None, 0.0)
        self._run_of, self._clock = run, clock
        self._at = run.position[0]
        self._driven, self._line_now = -1, 0
        self._end = MotionState.FINISHED
        self._rows = self._at[None]

    def update(self, now_s: float) -> None:
        """End the motion together with the recorded one."""
        if self.state is MotionState.RUNNING and self._clock.has_arrived(self._driven):
            self.state, self._at = self._end, self._run_of.moves[self._driven].goal

    def note_look(self) -> None:
        """Record that the host has read the status."""
        if self.state is self._end and self._driven >= 0:
            self._clock.mark_read(self._driven)

    @property
    def has_moved(self) -> bool:
        """Whether any motion has been ordered so far."""
        return self._driven >= 0

    def position(self, now_s: float) -> np.ndarray:
        """Recorded positions of the axes."""
        if self.state is not MotionState.RUNNING:
            return self._at
        columns = self._run_of.position.T
        self._at = np.array(
            [np.interp(self._clock.now_s, self._run_of.axes_s, c) for c in columns]
        )
        return self._at

    def feed_mm_min(self, now_s: float) -> float:
        """Always 0: a Run does not store it."""
        return 0.0

    def line(self, now_s: float) -> int:
        """Row of the nearest line, never an earlier one."""
        here = self.position(now_s)
        rows = range(self._line_now, min(self._line_now + _AHEAD, len(self._rows)))
        away = [_distance(here, self._rows[max(r - 1, 0)], self._rows[r]) for r in rows]
        self._line_now += int(np.argmin(away))
        return self._line_now

    def commit(self, program: Program) -> None:
        """Store a path."""
        super().commit(program)
        self._line_now = 0

    def move_to(self, row: Program, now_s: float) -> None:
        """With the recording while it runs, else immediate."""
        self._rows, self._line_now = row.position, 0
        if not self._clock.runs:
            self._driven = -1
            self._at, self.state = row.position[-1], MotionState.FINISHED
        else:
            self._drive()

    def start(self, now_s: float) -> Result:
        """Run the committed path with the recording."""
        if self.path is None:
            return Result.NO_PATH
        self._rows = self.path.position
        return self._drive()

    def hold(self, reason: HoldReason, now_s: float) -> None:
        """Report a hold; the recording continues."""
        if self.state is MotionState.RUNNING:
            self.state, self.hold_reason = MotionState.HELD, reason

    def resume(self, now_s: float) -> None:
        """Continue with the recording at its present time."""
        if self.state is MotionState.HELD:
            self.state, self.hold_reason = MotionState.RUNNING, HoldReason.NONE

    def abort(self, now_s: float) -> None:
        """Remove the path."""
        self.path = None
        self.state, self.hold_reason = MotionState.ABORTED, HoldReason.NONE

    def _drive(self) -> Result:
        """The recorded motion with the same end, else the last one.

        A motion that was ended early ends early again.
        """
        first, moves = self._driven + 1, self._run_of.moves
        if first >= len(moves):
            return Result.BAD_ARGUMENT
        ends = [
            number
            for number in range(first, len(moves))
            if np.abs(moves[number].goal - self._rows[-1]).max() <= _SAME
        ]
        self._driven = (ends or [len(moves) - 1])[0]
        self._end = MotionState.FINISHED if ends else MotionState.ABORTED
        self._clock.mark_ordered(first)
        self._clock.join_moves(first, self._driven)
        self.state, self.hold_reason = MotionState.RUNNING, HoldReason.NONE
        return Result.DONE


def _distance(here: np.ndarray, begin: np.ndarray, end: np.ndarray) -> float:
    way = end - begin
    share = np.dot(here - begin, way) / max(float(np.dot(way, way)), 1e-12)
    return float(np.linalg.norm(here - begin - np.clip(share, 0.0, 1.0) * way))
