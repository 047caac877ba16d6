"""Monitor of stream, controller and disk during all waiting of a measurement.

Ten times per second it feeds the controller's watchdog, reads the controller, assesses
the stream and the disk, and applies the operator's requests. An engine that hangs feeds
no watchdog, so the machine holds.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from truepath.driver_border import Call
from truepath.measurement.faults import (
    BEAM_LOST,
    DAMAGED,
    DISK_STAYS_SLOW,
    SILENT,
    SLOW_DISK,
    STALLED,
    STAYS_DAMAGED,
    UNMOVED,
    Aborted,
    Fault,
    classify_fault,
    make_beam_fault,
    make_position_fault,
    make_silence_fault,
    make_unable_fault,
)
from truepath.measurement.measurement_state import HoldReason, MeasurementState
from truepath.measurement.messages import CellState, ReportEvent
from truepath.measurement.monitors.controller_monitor import ControllerMonitor, FeedHold
from truepath.measurement.monitors.plausibility import (
    IN_A_ROW,
    ObservedPoint,
    PointCheck,
)
from truepath.measurement.monitors.stream_reader import StreamReader, StreamState
from truepath.measurement.progress import LiveView, ProgressEstimator, RowSchedule
from truepath.measurement.run_file.recorder import EventLog, Recorder
from truepath.measurement.target import SearchStep, Sight, TargetSearch
from truepath.measurement.time_limits import EngineSettings, Stopwatch
from truepath_drivers import host_clock
from truepath_drivers.interfaces.errors import DeviceError
from truepath_drivers.interfaces.motion import MotionController
from truepath_drivers.interfaces.records import UNABLE, MotionState, MotionStatus, Path
from truepath_drivers.interfaces.tracker import (
    AnyTracker,
    EventSource,
    PolledTracker,
    Tracker,
)

_SPARE_S = 1.0  # a driver gives up before


class MeasurementMonitor:
    """Stream, controller, disk and progress of one active measurement.

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
        places: PointCheck,
        search: TargetSearch | None = None,
    ) -> None:
        self.settings = settings
        self.motion, self.recorder, self.state = motion, recorder, state
        self.report = report
        self._tracker, self._view = tracker, view
        self.progress = ProgressEstimator(schedule, settings.progress_s)
        self.events = EventLog(recorder, report)
        self._machine = ControllerMonitor(
            motion, recorder, settings, lambda: self.stream.device_time_s
        )
        self.places = places
        self.feed = FeedHold(motion, self._machine, state, self.events, settings)
        self._disk = DiskMonitor(self.feed, state, recorder)
        self._motion_check = MotionCheck(self.events, settings)
        self.rows = RowsToRepeat(self.progress)
        self.stream = StreamMonitor(self.feed, state, self.events, self.rows, settings)
        self._recovery: TargetRecovery | None = None
        if search is not None:
            see = None if isinstance(tracker, PolledTracker) else self.stream.see
            self._recovery = TargetRecovery(
                search, see, self.progress, self.feed, state, self.rows, self.events
            )
        self._is_tracker_busy = False

    @property
    def position(self) -> tuple[float, ...]:
        """Every axis at the last reading, mm or deg."""
        return self._machine.position

    @property
    def position_by_axis(self) -> dict[str, float]:
        """Every axis at the last reading by name, mm or deg."""
        return dict(zip(self.motion.axes, self._machine.position, strict=True))

    def is_at(self, position: NDArray[np.float64] | tuple[float, ...]) -> bool:
        """Whether every axis was within `arrival` of it at the last reading."""
        away = np.abs(np.subtract(self._machine.position, position))
        return bool((away <= self.settings.arrival).all())

    def expect(self, path: Path) -> None:
        """Announce the next path, in the controller's axes."""
        self._machine.gate.expect(path, self._machine.position)

    def tick(self) -> MotionStatus | None:
        """Wait 0.1 s, then check everything.

        The controller's status, None if it did not answer this time. Raises Aborted, or
        Fault.
        """
        if host_clock.wait(self.state.aborted, self.settings.poll_s):
            raise Aborted("aborted on request")
        self._disk.check()
        self._report_device_events()
        self.stream.check(may_lose_beam=self._is_tracker_busy)
        here, status = self._machine.position, self._machine.poll()
        if status is None:
            self.feed.hold_blindly()
        else:
            self._apply_status(status)
            if self._recovery is not None:
                is_still = status.position == here
                self._recovery.follow(self.position_by_axis, is_still=is_still)
            self._assess_positions()
        self._report_progress()
        return status

    def _assess_positions(self) -> None:
        if self._machine.doubt:
            if self._machine.doubts >= IN_A_ROW:
                fault = make_position_fault(self._machine.doubt)
                self.feed.hold(HoldReason.POSITION, fault)
            return
        if isinstance(self._tracker, PolledTracker):
            return
        may_jump = self._is_tracker_busy or self.state.requires_standstill
        seen = None if may_jump else self.stream.read_newest_point()
        axes, name = self.position_by_axis, self.progress.target
        fault = self.places.follow(axes, name, seen, host_clock.now_s())
        if fault is not None:
            self.feed.hold(HoldReason.PLACE, fault)
            self.rows.note_damage()

    def wait_for_tracker(
        self, verb: Callable[[], None], limit_s: float
    ) -> BaseException | None:
        """Monitor while the tracker does something; gives the error if it failed.

        It may lose its beam meanwhile. Raises as `tick`, and Fault if it does not end.

        limit_s : time in which its driver completes it, or raises
        """
        limit_s += _SPARE_S
        task, late_s = Call(verb), host_clock.now_s() + limit_s
        self._is_tracker_busy = True
        try:
            while not task.is_over:
                self.tick()
                if host_clock.now_s() > late_s:
                    raise make_silence_fault(limit_s)
        finally:
            self._is_tracker_busy = False
        return task.failure

    def end(self) -> None:
        """End the stream and record pending data. Idempotent, never raises."""
        self.stream.end()
        self._machine.flush()

    def _report_device_events(self) -> None:
        devices = self._tracker, self.motion
        sources = (device for device in devices if isinstance(device, EventSource))
        for event in (event for source in sources for event in source.take_events()):
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


BY_ITSELF_S = 10.0
"""Limit of an automatic resume: after it an operator may be at the machine."""


class DiskMonitor:
    """The disk of one measurement. Belongs to the thread of the engine."""

    def __init__(
        self, feed: FeedHold, state: MeasurementState, recorder: Recorder
    ) -> None:
        self._feed, self._state, self._recorder = feed, state, recorder
        self._held = Stopwatch()

    def check(self) -> None:
        """Hold the feed while the queue is too long. Raises Fault if the disk fails."""
        recorder = self._recorder
        if recorder.failure or recorder.is_space_low:
            text = recorder.failure or "the disk is almost full"
            action = "free some space, then measure again"
            raise Fault("storage", text, action)
        if recorder.is_strained:
            self._feed.hold(HoldReason.DISK, SLOW_DISK)
        if HoldReason.DISK not in self._state.holds:
            self._held.reset()
        elif self._held.measure_s() > BY_ITSELF_S:
            self._feed.hold(HoldReason.DISK_STAYED_SLOW, DISK_STAYS_SLOW)
        if recorder.is_relaxed and HoldReason.DISK in self._state.holds:
            self._feed.release(HoldReason.DISK, "the disk has caught up")


class MotionCheck:
    """Detects a machine that reports motion but does not move."""

    def __init__(self, events: EventLog, settings: EngineSettings) -> None:
        self._events, self._settings = events, settings
        self._unmoved = Stopwatch()
        self._position_before: tuple[float, ...] = ()
        self._is_reported = False

    def follow(self, status: MotionStatus, longest_row_s: float) -> None:
        """Report once that a running machine does not move.

        longest_row_s : planned, the time for which a machine may dwell
        """
        is_stuck = (
            status.state is MotionState.RUNNING
            and status.position == self._position_before
        )
        self._position_before = status.position
        if not is_stuck:
            self._unmoved.reset()
            self._is_reported = False
            return
        stalled = status.override == 0.0
        # A machine that dwells does not move either; one at 0 % does not dwell.
        patience_s = 0.0 if stalled else longest_row_s
        late = self._unmoved.measure_s() > self._settings.stuck_s + patience_s
        if late and not self._is_reported:
            self._is_reported = True
            self._events.report_fault(STALLED if stalled else UNMOVED)


# Without a valid sample. Figures of a circle need some in every 3°: on one of 230 mm
# these take 0.12 s at 3000 mm/min.
_BREAK_S = 0.1


class StreamMonitor:
    """The stream of one measurement, once it is opened.

    `is_good` is for any thread; everything else belongs to the thread of the engine.
    """

    def __init__(
        self,
        feed: FeedHold,
        state: MeasurementState,
        events: EventLog,
        rows: RowsToRepeat,
        settings: EngineSettings,
    ) -> None:
        self._feed, self._state, self._events = feed, state, events
        self._rows, self._timeouts = rows, settings.timeouts
        self._stream: StreamReader | None = None
        self._damaged = Stopwatch()

    def watch(self, stream: StreamReader) -> None:
        """Assess this stream from now on."""
        self._stream = stream

    def end(self) -> None:
        """End the stream; an error of the tracker is only recorded."""
        if self._stream is not None:
            try:
                self._stream.stop()
            except DeviceError as error:
                self._events.record("tracker", str(error))

    @property
    def is_good(self) -> bool:
        """Whether an active stream carries valid samples; true without a stream."""
        return self._stream is None or self._stream.assess() is StreamState.GOOD

    @property
    def device_time_s(self) -> float | None:
        """The tracker's clock at its newest sample, None before the first."""
        return None if self._stream is None else self._stream.device_time_s

    @property
    def place_mm(self) -> NDArray[np.float64] | None:
        """Target position in the newest valid sample, None before the first."""
        seen = None if self._stream is None else self._stream.seen
        return None if seen is None else seen.place_mm

    def see(self) -> NDArray[np.float64] | None:
        """Present target position, (3,) mm; None while the target is not seen."""
        stream = self._stream
        if stream is None or stream.assess() is not StreamState.GOOD:
            return None
        return self.place_mm if stream.is_seen else None

    def read_newest_point(self) -> ObservedPoint | None:
        """Newest target position; None where the stream is not good."""
        return self._stream.seen if self._stream is not None and self.is_good else None

    def check(self, *, may_lose_beam: bool) -> None:
        """Hold the feed while the stream is not good. Raises Fault if it stays so.

        may_lose_beam : the tracker changes its target
        """
        if self._stream is None:
            return
        if self._stream.failure is not None:
            raise classify_fault(self._stream.failure)
        state = self._stream.assess()
        if state is StreamState.DEAD:
            raise make_silence_fault(self._timeouts.dead_s)
        if state is StreamState.SILENT:
            self._feed.hold(HoldReason.SILENCE, SILENT)
        elif state is StreamState.BEAM_LOST and not may_lose_beam:
            self._feed.hold(HoldReason.BEAM, BEAM_LOST)
            self._rows.note_loss()
        elif state is StreamState.GOOD:
            # Too short for an operator to be at the machine: resume automatically.
            for reason in {HoldReason.SILENCE, HoldReason.DAMAGE} & self._state.holds:
                self._feed.release(reason, "the stream is good again")
        lacks_samples = self._stream.pop_gap_s() > _BREAK_S
        self._rows.follow(is_broken=lacks_samples or self._state.requires_standstill)
        self._follow_damage(is_damaged=state is StreamState.DAMAGED)

    def _follow_damage(self, *, is_damaged: bool) -> None:
        if not is_damaged:
            self._damaged.reset()
            return
        self._feed.hold(HoldReason.DAMAGE, DAMAGED)
        self._rows.note_damage()
        if self._damaged.measure_s() > self._timeouts.damaged_s:
            raise STAYS_DAMAGED


_TICKS_LATE = 12  # looks of 0.1 s over which damage is detected late


class RowsToRepeat:
    """Keeps the first row whose stream was damaged, or whose target was lost.

    Also the rows with a standstill or missing samples: harmless for a line, whose other
    samples count, but they make an arc useless.
    """

    def __init__(self, progress: ProgressEstimator) -> None:
        self._progress = progress
        self._rows: deque[int] = deque(maxlen=_TICKS_LATE)
        self._damaged_row: int | None = None
        self._lost_row: int | None = None
        self._broken_rows: set[int] = set()

    def follow(self, *, is_broken: bool) -> None:
        """Note the current row, once per look.

        is_broken : the machine is held, or samples are missing that were due recently
        """
        self._rows.append(self._progress.row)
        if is_broken and self._progress.stage == "measuring":
            self._broken_rows.update(self._rows)

    def note_damage(self) -> None:
        """Keep the row in which the damage of the stream began."""
        if self._progress.stage == "measuring" and self._damaged_row is None:
            self._damaged_row = self._rows[0]

    def note_loss(self) -> None:
        """Keep the row in which the target was lost."""
        if self._lost_row is None and self._progress.stage == "measuring":
            self._lost_row = self._rows[0]

    def discard_loss(self) -> None:
        """The target was recovered by an operator: no row is to be repeated."""
        self._lost_row = None

    def repeat_loss(self) -> None:
        """The target was recovered automatically: its line is to be repeated."""
        if self._progress.point is None and self._damaged_row is None:
            self._damaged_row = self._lost_row

    def pop_row(self) -> int | None:
        """First row since the last call that has to be repeated."""
        row, self._damaged_row = self._damaged_row, None
        return row

    def pop_broken_rows(self) -> frozenset[int]:
        """Rows since the last call with a standstill or missing samples."""
        rows, self._broken_rows = frozenset(self._broken_rows), set()
        return rows


class TargetRecovery:
    """Reaction of a measurement to a lost target that its tracker can search.

    see : None for a polled tracker
    """

    def __init__(
        self,
        search: TargetSearch,
        see: Sight | None,
        progress: ProgressEstimator,
        feed: FeedHold,
        state: MeasurementState,
        rows: RowsToRepeat,
        events: EventLog,
    ) -> None:
        self._search, self._see, self._progress = search, see, progress
        self._feed, self._state, self._rows = feed, state, rows
        self._events = events

    def follow(self, position: dict[str, float], *, is_still: bool) -> None:
        """Remember the target's position; let the tracker search a lost one.

        position : of every axis, by name
        """
        name, point = self._progress.target, self._progress.point
        if HoldReason.BEAM not in self._state.holds:
            self._search.discard_loss()
            self._rows.discard_loss()
            place_mm = None if self._see is None else self._see()
            if place_mm is not None:
                self._search.remember(position, name, place_mm, is_still=is_still)
        elif self._state.state is CellState.PAUSED:
            key = -1 if point is None else point
            step = self._search.advance(position, name, key, self._see)
            if step is not None:
                self._apply(step)

    def _apply(self, step: SearchStep) -> None:
        self._events.record("found" if step.has_found else "search", step.text)
        if step.has_found:
            self._rows.repeat_loss()
            self._feed.release(HoldReason.BEAM, "the target was found again")
        elif step.is_last:
            fault = make_beam_fault(f"{BEAM_LOST.text}; {step.text}")
            self._events.report_fault(fault)
