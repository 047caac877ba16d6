"""One measurement by the cell, from its beginning to its closed Run.

Every reply of the cell has a deadline. If it does not confirm a hold, a resume or an
abort in time, its process is killed, and the machine's own watchdog holds the feed. A
line that does not end after a cancel is aborted.
"""

from __future__ import annotations

import queue
from collections.abc import Collection, Mapping
from dataclasses import asdict

import structlog

from truepath.catalogue.errors import (
    Aborted,
    LineUnfinished,
    MachineFault,
    MeasurementEnded,
)
from truepath.catalogue.job import Failure, Health, Progress, Stage
from truepath.catalogue.transitions import State, Verb
from truepath.errors import MeasurementFailed
from truepath.jobs.running.active_job import ActiveJob
from truepath.jobs.running.live_estimation import LiveSteering
from truepath.machines.cell_status import MOVING
from truepath.machines.cell_supervisor import CellSupervisor
from truepath.measurement.measurement_state import ENDS
from truepath.measurement.messages import (
    CellEvent,
    CellState,
    CellVerb,
    FaultReported,
    LinesDamaged,
    LivePoints,
    MeasurementOrder,
    MeasurementProgress,
    RunClosed,
    StateChanged,
)
from truepath.motion.motion_times import row_times_s
from truepath_drivers import host_clock

log = structlog.get_logger(__name__)

CONFIRM_S = {
    State.PAUSING: 30.0,  # a standstill point may be finished first
    State.RESUMING: 30.0,
    State.ABORTING: 10.0,
    State.CANCELLING: 60.0,  # beyond the time of the current line or point
}
LINE_TIMES = 2.0  # of the current line or point, that cancelling may last
CLOSE_RUN_S = 60.0
REPEAT_S = 1.0
_POLL_S = 0.1
_STOPPED_ELSEWHERE = "ended-early"  # than it was sent, which an abort leads to

_INSPECT_MACHINE = (
    "Make sure that the machine stands, look at the log for the cause, then measure "
    "again; what was recorded is kept."
)

_LOOK_AT_CONTROLLER = (
    "Look at the control for what kept the line from ending: a stop, a message, an "
    "override of 0 %; then measure again; what was recorded is kept."
)


class CellMeasurement:
    """Handles the events of the cell in order, in the job's thread.

    gives_up : codes of faults that end it without waiting for an operator
    """

    def __init__(
        self,
        job: ActiveJob,
        cell: CellSupervisor,
        *,
        confirm_s: Mapping[State, float],
        steering: LiveSteering | None,
        gives_up: Collection[str] = (),
    ) -> None:
        self._job, self._cell, self._steering = job, cell, steering
        self._confirm_s = confirm_s
        self._events: queue.SimpleQueue[CellEvent | None] = queue.SimpleQueue()
        self._fault: FaultReported | None = None
        self._outcome: CellState | None = None
        self._close_by = float("inf")
        self._repeat_at = host_clock.now_s() + REPEAT_S
        self._is_killed = self._is_given_up = self._is_held = self._is_stopped = False
        self._is_overdue, self._line_s = False, 0.0
        self._gives_up = gives_up
        self._repeats = 0

    def run(self, order: MeasurementOrder) -> None:
        """Measure until the Run is closed; recorded data are on disk in any case.

        Raises Aborted, Cancelled, Interrupted, MeasurementEnded, MachineFault.
        """
        self._line_s = float(row_times_s(order.commanded).max(initial=0.0))
        if not self._cell.begin(
            order,
            self._events.put,
            lambda: self._job.is_cancelled or self._job.wants_cancel,
        ):
            self._job.checkpoint()
        try:
            self._follow_events()
        except Exception:
            self._cell.send(CellVerb.ABORT)
            self._wait_until_closed()
            raise
        finally:
            self._cell.ignore_events()
        self._raise_outcome()

    def _follow_events(self) -> None:
        while True:
            self._repeat_command()
            if self._steering is not None:
                is_running = self._job.state is State.RUNNING
                self._steering.advance(may_conclude=is_running)
            self._check_deadlines()
            try:
                event = host_clock.get(self._events, _POLL_S)
            except queue.Empty:
                continue
            if event is None:
                self._outcome = CellState.FAULTED
                text = "the cell process has died; the machine's watchdog holds"
                died = FaultReported("cell-died", text, _INSPECT_MACHINE)
                self._fault = self._fault or died
                return
            if isinstance(event, RunClosed):
                self._job.set_sample_counts(event.samples, event.lost_samples)
                return
            self._handle_event(event)

    def _wait_until_closed(self) -> None:
        deadline = host_clock.now_s() + CLOSE_RUN_S
        while (left_s := deadline - host_clock.now_s()) > 0:
            try:
                event = host_clock.get(self._events, left_s)
            except queue.Empty:
                break
            if event is None or isinstance(event, RunClosed):
                return
        self._cell.kill()

    def _handle_event(self, event: CellEvent) -> None:
        if isinstance(event, LinesDamaged):
            self._repeats += 1
        match event:
            case MeasurementProgress():
                self._report_progress(event)
            case LivePoints():
                self._job.publish("live", asdict(event))
            case FaultReported():
                self._show_fault(event)
            case StateChanged(state):
                self._follow_state(state)
            case _ if self._steering is not None:
                self._steering.handle(event)

    def _report_progress(self, event: MeasurementProgress) -> None:
        total, left_s = event.total, event.remaining_s
        self._line_s = event.line_s or self._line_s
        if self._steering is not None:
            total = self._steering.count_total(total)
        if total > event.total:
            left_s += event.elapsed_s * (total - event.total) / max(event.total, 1)
        progress = Progress(
            float(event.done),
            float(total),
            event.unit,
            left_s,
            event.elapsed_s,
            event.position,
        )
        health = Health(
            event.samples,
            event.lost_samples,
            event.crc_errors,
            event.gaps,
            self._repeats,
        )
        self._job.report_progress(progress, stage=Stage.MEASURING, health=health)

    def _show_fault(self, fault: FaultReported) -> None:
        """Only the state of the cell decides whether a fault ends the job."""
        log.error("fault", job_id=self._job.job_id, **asdict(fault))
        self._fault = fault
        if fault.code == _STOPPED_ELSEWHERE and self._job.is_aborted:
            self._is_stopped = True  # a cell that was frozen sees that before the abort
            return
        if fault.code in self._gives_up:
            self._is_given_up = True
            self._close_by = min(self._close_by, host_clock.now_s() + CLOSE_RUN_S)
            self._cell.send(CellVerb.ABORT)
            return
        self._job.show_failure(
            Failure("MachineFault", fault.text, fault.code, fault.action)
        )

    def _follow_state(self, reported: CellState) -> None:
        if reported in ENDS:
            self._outcome = reported
            self._close_by = host_clock.now_s() + CLOSE_RUN_S
            return
        if reported not in MOVING:
            return
        self._is_held = reported is not CellState.RUNNING
        state = State(reported)  # the same word
        # A `running` that the cell sent before a pause reached it must not undo it.
        late = state is State.RUNNING
        job = self._job.enter(state, Stage.MEASURING, unless_pausing=late)
        if job.state is State.RUNNING:
            self._fault = None
            self._job.show_failure(None)

    def _repeat_command(self) -> None:
        """A command that is not confirmed may have come too early to act. A pause is
        repeated only if a user requested it: the cell resumes from its own pauses, not
        from a commanded one. A held machine is not moved to finish its line for a
        cancel.
        """
        now = host_clock.now_s()
        if self._outcome or now < self._repeat_at:
            return
        self._repeat_at = now + REPEAT_S
        if self._job.is_cancelled or self._is_given_up or self._is_overdue:
            self._cell.send(CellVerb.ABORT)
        elif self._job.wants_cancel:
            self._cell.send(CellVerb.ABORT if self._is_held else CellVerb.CONCLUDE)
        elif self._job.wants_pause and self._job.state is not State.PAUSED:
            self._cell.send(CellVerb.PAUSE)

    def _check_deadlines(self) -> None:
        state = self._job.state
        limit_s = float("inf") if self._outcome else self._confirm_s.get(state)
        if limit_s is not None and state is State.CANCELLING:
            limit_s += LINE_TIMES * self._line_s
        overdue = limit_s is not None and self._job.state_lasts_s > limit_s
        if overdue and state is State.CANCELLING:
            self._stop_cancelling()
        elif overdue and not self._is_killed:
            self._kill_cell(
                f"not-{state}", f"the cell has not confirmed {state} in time"
            )
        if host_clock.now_s() > self._close_by:
            self._close_by = float("inf")
            self._kill_cell("run-not-closed", "the cell has not closed its Run in time")

    def _stop_cancelling(self) -> None:
        lasted_s = self._job.state_lasts_s
        log.error("cancel overdue", job_id=self._job.job_id, lasted_s=lasted_s)
        self._is_overdue = True
        text = (
            f"the line or point under way was to end first, but had not after "
            f"{lasted_s:.0f} s; the feed was held"
        )
        self._fault = FaultReported("cancel-overdue", text, _LOOK_AT_CONTROLLER)
        self._cell.send(CellVerb.ABORT)
        self._job.apply_verb(Verb.ABORT)

    def _kill_cell(self, code: str, text: str) -> None:
        log.error("cell given up", job_id=self._job.job_id, code=code)
        self._is_killed = True
        ended = f"{text}; its process was ended and the machine's watchdog holds"
        self._fault = FaultReported(code, ended, _INSPECT_MACHINE)
        self._cell.kill()

    def _raise_outcome(self) -> None:
        fault = self._fault or FaultReported("", "", "")
        code, text, action = fault.code, fault.text, fault.action
        if self._outcome is CellState.FAULTED and not self._is_stopped:
            raise MachineFault(code or "fault", text or "the machine faulted", action)
        if self._is_overdue:
            raise LineUnfinished("cancel-overdue", text, action)
        self._job.checkpoint()
        match self._outcome:
            case CellState.FINISHED:
                return
            case CellState.ABORTED if self._is_given_up:
                raise MeasurementEnded(code, text, action)
            case CellState.ABORTED:
                raise Aborted("aborted at the machine")
            case CellState.FAILED:
                raise MeasurementEnded(code or "failed", text or "it failed", action)
        raise MeasurementFailed("the cell closed its Run without saying why")
