"""The controller of the CNC without its wire: path, states, motion. Time is given.

Every change of the motion takes effect shortly after the decision, so that it is
published before any process needs it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from truepath_drivers.cnc.modbus.registers import (
    ALLOWED,
    DRIVES_ARCS,
    MAX_WAYPOINTS,
    TELLS_COMPENSATION,
    TELLS_OVERRIDE,
    TELLS_REFERENCED,
    Command,
    HoldReason,
    Result,
)
from truepath_drivers.interfaces.records import UNABLE, MotionState
from truepath_simulators.machine_file import MachineFile
from truepath_simulators.motion import planner
from truepath_simulators.motion.planner import make_program_timeline
from truepath_simulators.motion.profile import Limits
from truepath_simulators.motion.program import Program
from truepath_simulators.timeline import Timeline, standing

MAX_FEED_MM_MIN = 40_000.0
# In lead times: a minute on the wall, longer than a tracker process is ever late.
_KEPT = 3000.0
# Planning and publishing thousands of rows takes some 30 ms; a brake takes one.
_LONG_LEAD = 5.0


class Controller:
    """States and motion of one machine. All times are machine seconds.

    publish : receives every new timeline before it takes effect
    lead_s : delay until a decision to brake takes effect; five times as long for one to
        move
    """

    model = "Simulated CNC"
    features = TELLS_OVERRIDE | TELLS_REFERENCED | TELLS_COMPENSATION | DRIVES_ARCS

    def __init__(
        self,
        machine: MachineFile,
        limits: Limits,
        publish: Callable[[Timeline], None],
        lead_s: float,
    ) -> None:
        self.machine = machine
        self.state = MotionState.IDLE
        self.hold_reason = HoldReason.NONE
        self.alarm_code = 0
        self.alarm_text = ""
        self.path: Program | None = None
        self.is_referenced = True
        self.is_compensating = False
        self._limits = limits
        self._publish = publish
        self._lead_s = lead_s
        self._override = 1.0
        self._running: Program | None = None
        self._stopping_for: MotionState | None = None
        self._stopping_reason = HoldReason.NONE
        self._runs_path = False
        self._line = 0
        self._begin_s = 0.0
        home = np.where((machine.low <= 0.0) & (machine.high >= 0.0), 0.0, machine.low)
        self._timeline = standing(home, 0.0, 0)
        publish(self._timeline)

    def update(self, now_s: float) -> None:
        """Advance the time: a motion that has ended changes the state."""
        if self.state is not MotionState.RUNNING or now_s < self._timeline.end_s:
            return
        if self._is_stalled and self._stopping_for is None:
            return  # it reports RUNNING and stands
        self.state = self._stopping_for or MotionState.FINISHED
        self.hold_reason = self._stopping_reason
        self._stopping_for, self._stopping_reason = None, HoldReason.NONE

    @property
    def has_moved(self) -> bool:
        """Whether any motion has been ordered so far."""
        return self._running is not None

    def position(self, now_s: float) -> np.ndarray:
        """Axis positions, mm or deg."""
        return self._timeline.positions(np.array([now_s]))[0]

    def feed_mm_min(self, now_s: float) -> float:
        """Feed along the path."""
        return 60.0 * max(float(self._timeline.speeds(np.array([now_s]))[0]), 0.0)

    def line(self, now_s: float) -> int:
        """Row of the path towards which the machine moves, or at which it dwells."""
        if self._runs_path:
            at_s = max(now_s, self._begin_s)  # until then it shows an earlier program
            self._line = int(self._timeline.rows(np.array([at_s]))[0])
        return self._line

    def find_state_conflict(self, command: Command) -> Result | None:
        """Reason why a command is not possible in this state; None if it is."""
        if self.state in ALLOWED[command]:
            return None
        if self.state is MotionState.ALARM:
            return Result.IN_ALARM
        return Result.NOT_READY if self.state in UNABLE else Result.WRONG_STATE

    def check_program(self, program: Program) -> Result | None:
        """Fault of the rows of a path; None if there is none."""
        feed_mm_min = 60.0 * program.feed_mm_s
        if np.any(feed_mm_min <= 0.0) or np.any(feed_mm_min > MAX_FEED_MM_MIN):
            return Result.BAD_ARGUMENT
        if not 0 < len(program) <= MAX_WAYPOINTS or np.any(program.dwell_s < 0.0):
            return Result.BAD_ARGUMENT
        places = [program.position]
        for row, arc in enumerate(program.arc):
            if arc is None:
                continue
            begin, end = program.position[max(row - 1, 0)], program.position[row]
            if row == 0 or not arc.fits(begin, end):
                return Result.BAD_ARGUMENT
            places.append(arc.reach(begin))
        inside = [
            ((at >= self.machine.low - 1e-9) & (at <= self.machine.high + 1e-9)).all()
            for at in places
        ]
        return None if all(inside) else Result.OUT_OF_TRAVEL

    def commit(self, program: Program) -> None:
        """Store a path that `check_program` has passed."""
        self.path = program
        self.state = MotionState.READY
        self._runs_path, self._line = False, 0

    def discard_path(self) -> None:
        self.path = None
        if self.state is MotionState.READY:
            self.state = MotionState.IDLE

    def move_to(self, row: Program, now_s: float) -> None:
        """Move on a straight line to a position that `check_program` has passed."""
        self._runs_path, self._line = False, 0
        self._run(row, now_s)

    def start(self, now_s: float) -> Result:
        """Run the committed path from its first row."""
        if self.path is None:
            return Result.NO_PATH
        self._runs_path = True
        self._run(self.path, now_s)
        return Result.DONE

    def hold(self, reason: HoldReason, now_s: float) -> None:
        """Brake along the line and stay there; no effect without a motion."""
        if self.state is MotionState.RUNNING and self._stopping_for is None:
            self._brake(MotionState.HELD, now_s)
            self._stopping_reason = reason

    def resume(self, now_s: float) -> None:
        """Continue after a hold; while braking for one, as soon as the axes stand."""
        braking = self._stopping_for is MotionState.HELD
        if (self.state is not MotionState.HELD and not braking) or not self._running:
            return
        begin_s = max(now_s + _LONG_LEAD * self._lead_s, self._timeline.end_s)
        self._go_on(begin_s)
        self.state = MotionState.RUNNING
        self.hold_reason = HoldReason.NONE
        self._stopping_for, self._stopping_reason = None, HoldReason.NONE

    def abort(self, now_s: float) -> None:
        """Stop and remove the path."""
        if self.state in UNABLE:
            return
        self.path = None
        if self.state is not MotionState.RUNNING:
            self.state, self.hold_reason = MotionState.ABORTED, HoldReason.NONE
        elif self._stopping_for is None:
            self._brake(MotionState.ABORTED, now_s)
        elif self._stopping_for is MotionState.HELD:
            self._stopping_for = MotionState.ABORTED
            self._stopping_reason = HoldReason.NONE

    def alarm(self, code: int, text: str, now_s: float) -> None:
        self.alarm_code, self.alarm_text = code, text
        self.disable(MotionState.ALARM, now_s)

    def disable(self, state: MotionState, now_s: float) -> None:
        """Stop for a state in which the machine cannot move."""
        if state is MotionState.UNHOMED:
            self.is_referenced = False
        if self.state is not MotionState.RUNNING:
            self.state, self.hold_reason = state, HoldReason.NONE
        elif self._stopping_for is None:
            self._brake(state, now_s)
        else:
            self._stopping_for = state
            self._stopping_reason = HoldReason.NONE

    def enable(self) -> None:
        """Leave a state whose cause has gone; the path is removed."""
        if self.state in UNABLE:
            self.state, self.path = MotionState.IDLE, None
            self.alarm_code, self.alarm_text = 0, ""

    @property
    def feed_override(self) -> float:
        """Factor on the feed."""
        return self._override

    def override(self, factor: float, now_s: float) -> None:
        """Set the feed override; 1 is the programmed feed, at 0 nothing moves."""
        was_stalled = self._is_stalled
        self._override = factor
        if self.state is not MotionState.RUNNING or self._stopping_for is not None:
            return
        at_s = now_s + _LONG_LEAD * self._lead_s
        if self._is_stalled:
            self._slow_down(now_s)
        elif was_stalled:
            self._go_on(max(at_s, self._timeline.end_s))
        else:
            self._change(
                planner.with_feed(self._timeline, self._fed(), at_s, self._limits)
            )

    @property
    def _is_stalled(self) -> bool:
        return self._override == 0.0

    def _run(self, program: Program, now_s: float) -> None:
        self._running = program
        begin_s = self._begin_s = now_s + _LONG_LEAD * self._lead_s
        self.state, self.hold_reason = MotionState.RUNNING, HoldReason.NONE
        past = self._recent(now_s).cut(begin_s)
        origin = self.position(begin_s)
        if self._is_stalled:
            self._change(past.then(standing(origin, begin_s, 0)))
            return
        self._change(
            past.then(make_program_timeline(self._fed(), origin, begin_s, self._limits))
        )

    def _go_on(self, begin_s: float) -> None:
        self._begin_s = begin_s
        if self._is_stalled:
            return
        self._change(
            planner.resume_motion(self._timeline, self._fed(), begin_s, self._limits)
        )

    def _slow_down(self, now_s: float) -> None:
        # A standstill before the begin of a motion is no dwell of its program.
        at_s = max(now_s + self._lead_s, self._begin_s)
        if self._running is not None:
            self._running = planner.find_rest(self._timeline, self._running, at_s)
        self._change(planner.hold_motion(self._recent(now_s), at_s, self._limits))

    def _brake(self, state: MotionState, now_s: float) -> None:
        self._slow_down(now_s)
        self._stopping_for = state

    def _recent(self, now_s: float) -> Timeline:
        return self._timeline.since(now_s - _KEPT * self._lead_s)

    def _fed(self) -> Program:
        if self._running is None:
            raise RuntimeError("nothing runs")
        feed = self._running.feed_mm_s * self._override
        return replace(self._running, feed_mm_s=feed)

    def _change(self, timeline: Timeline) -> None:
        self._timeline = timeline
        self._publish(timeline)
