"""Monitors stream, controller and disk while a measurement waits for anything.

Ten times a second it feeds the controller's watchdog, reads the controller, assesses
the stream and the disk, and applies what the operator asks for. An engine that hangs
feeds no watchdog, so the machine holds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from truepath.app.measurement.controller_monitor import ControllerMonitor
from truepath.app.measurement.disk_monitor import DiskMonitor
from truepath.app.measurement.event_log import EventLog
from truepath.app.measurement.faults import (
    Aborted,
    Fault,
    make_position_fault,
    make_silence_fault,
    make_unable_fault,
)
from truepath.app.measurement.feed_hold import FeedHold
from truepath.app.measurement.measurement_state import HoldReason, MeasurementState
from truepath.app.measurement.messages import CellState, ReportEvent
from truepath.app.measurement.motion_check import MotionCheck
from truepath.app.measurement.plausibility import IN_A_ROW, PlaceCheck
from truepath.app.measurement.progress import LiveView, ProgressEstimator, RowSchedule
from truepath.app.measurement.recorder import Recorder
from truepath.app.measurement.rows_to_repeat import RowsToRepeat
from truepath.app.measurement.stream_monitor import StreamMonitor
from truepath.app.measurement.target_recovery import TargetRecovery
from truepath.app.measurement.target_search import TargetSearch
from truepath.app.measurement.timing import EngineSettings
from truepath.app.measurement.tracker_task import TrackerTask
from truepath.drivers.interfaces.motion import MotionController
from truepath.drivers.interfaces.records import UNABLE, MotionStatus, Path
from truepath.drivers.interfaces.tracker import (
    AnyTracker,
    EventSource,
    PolledTracker,
    Tracker,
)

_SPARE_S = 1.0  # a driver gives up before


class MeasurementMonitor:
    """Stream, controller, disk and progress of one measurement under way.

    `stream.is_good` and what `events` offers are for any thread; everything else
    belongs to the thread of the engine.
    """

    def __init__(
        self,
        tracker: AnyTracker,
        motion: MotionController,
        recorder: Recorder,
        state: MeasurementState,
        view: LiveView,
        report: ReportEvent,
        schedule: RowSchedule,
        settings: EngineSettings,
        places: PlaceCheck,
        search: TargetSearch | None = None,
    ) -> None:
        self.settings, self.clock = settings, settings.clock
        self.motion, self.recorder, self.state = motion, recorder, state
        self.report = report
        self._tracker, self._view = tracker, view
        self.progress = ProgressEstimator(schedule, settings.progress_s, settings.clock)
        self.events = EventLog(recorder, report)
        self._machine = ControllerMonitor(
            motion, recorder, settings, lambda: self.stream.device_time_s
        )
        self.places = places
        self.feed = FeedHold(motion, self._machine, state, self.events, settings)
        self._disk = DiskMonitor(self.feed, state, recorder, settings)
        self._motion_check = MotionCheck(self.events, settings)
        self.rows = RowsToRepeat(self.progress)
        self.stream = StreamMonitor(self.feed, state, self.events, self.rows, settings)
        self._recovery = self._make_recovery(search)
        self._is_task_under_way = False

    def _make_recovery(self, search: TargetSearch | None) -> TargetRecovery | None:
        if search is None:
            return None
        is_polled = isinstance(self._tracker, PolledTracker)
        return TargetRecovery(
            search,
            None if is_polled else self.stream.see,
            self.progress,
            self.feed,
            self.state,
            self.rows,
            self.events,
        )

    @property
    def position(self) -> tuple[float, ...]:
        """Of every axis at the last reading."""
        return self._machine.position

    @property
    def position_by_axis(self) -> dict[str, float]:
        """Of every axis at the last reading, by its name."""
        return dict(zip(self.motion.axes, self._machine.position, strict=True))

    def is_at(self, position: NDArray[np.float64] | tuple[float, ...]) -> bool:
        """Whether every axis was at this position at the last reading."""
        away = np.abs(np.subtract(self._machine.position, position))
        return bool((away <= self.settings.arrival).all())

    def expect(self, path: Path) -> None:
        """Take note of what the controller is about to drive, in its axes."""
        self._machine.gate.expect(path, self._machine.position)

    def tick(self) -> MotionStatus | None:
        """Wait a tenth of a second, then check everything.

        Returns the controller's status, None if it did not answer this time. Raises
        Aborted, or Fault.
        """
        if self.state.aborted.wait(self.settings.poll_s):
            raise Aborted("aborted on request")
        self._disk.check()
        self._report_tracker_events()
        self.stream.check(may_lose_beam=self._is_task_under_way)
        here, status = self._machine.position, self._machine.poll()
        if status is None:
            self.feed.hold_blindly()
        else:
            self._apply_status(status)
            if self._recovery is not None:
                stands = status.position == here
                self._recovery.follow(self.position_by_axis, stands=stands)
            self._judge_positions()
        self._report_progress()
        return status

    def _judge_positions(self) -> None:
        if self._machine.doubt:
            if self._machine.doubts >= IN_A_ROW:
                fault = make_position_fault(self._machine.doubt)
                self.feed.hold(HoldReason.POSITION, fault)
            return
        if isinstance(self._tracker, PolledTracker):
            return
        may_jump = self._is_task_under_way or self.state.must_stand
        seen = None if may_jump else self.stream.find_seen()
        axes, name = self.position_by_axis, self.progress.target
        fault = self.places.follow(axes, name, seen, self.clock())
        if fault is not None:
            self.feed.hold(HoldReason.PLACE, fault)
            self.rows.note_damage()

    def wait_for_tracker(
        self, verb: Callable[[], None], limit_s: float
    ) -> Exception | None:
        """Look on while the tracker does something; return why it was not done.

        It may lose its beam meanwhile. Raises as `tick`, and Fault if it does not end.

        limit_s : in which its driver ends it, or gives up
        """
        limit_s += _SPARE_S
        task, late_s = TrackerTask(verb), self.clock() + limit_s
        self._is_task_under_way = True
        try:
            while not task.is_over:
                self.tick()
                if self.clock() > late_s:
                    raise make_silence_fault(limit_s)
        finally:
            self._is_task_under_way = False
        return task.failure

    def end(self) -> None:
        """End the stream and record what waits. Idempotent, never raises."""
        self.stream.end()
        self._machine.flush()

    def _report_tracker_events(self) -> None:
        """Record what happens at the tracker; report what somebody has to look at."""
        if not isinstance(self._tracker, EventSource):
            return
        for event in self._tracker.take_events():
            if event.action:
                fault = Fault(event.kind, event.text, event.action)
                self.events.report_fault(fault)
            else:
                self.events.record(event.kind, event.text)

    def _apply_status(self, status: MotionStatus) -> None:
        if status.state in UNABLE:
            raise make_unable_fault(status, latched=True)
        self._view.axes = status.position
        self.progress.follow(status.line)
        self.progress.pass_time(active=self.state.state is CellState.RUNNING)
        self.state.observe(status.state, status.hold_reason)
        self._motion_check.follow(status, self.progress.longest_row_s)
        self.feed.follow(status)

    def _report_progress(self) -> None:
        progress = self.progress.next_report()
        if progress is not None:
            self.report(
                replace(
                    progress,
                    position=self._machine.position,
                    samples=self.recorder.samples,
                    lost_samples=self.recorder.lost_samples,
                    crc_errors=self._crc_errors,
                    gaps=self.recorder.gaps,
                    queue_depth=self.recorder.queue_depth,
                    commits=self.recorder.commits,
                )
            )

    @property
    def _crc_errors(self) -> int:
        tracker = self._tracker
        return tracker.health.crc_errors if isinstance(tracker, Tracker) else 0
