"""Monitors stream, controller and disk while a measurement waits for anything.

Ten times a second it feeds the controller's watchdog, reads the controller, assesses
the stream and the disk, and applies what the operator asks for. An engine that hangs
feeds no watchdog, so the machine holds.
"""

from __future__ import annotations

import contextlib
from collections import deque
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from truepath.app.errors import MeasurementFailed
from truepath.app.measurement.controller_monitor import ControllerMonitor
from truepath.app.measurement.faults import (
    BEAM_LOST,
    DAMAGED,
    HOMED,
    POINTS_ONLY,
    SILENT,
    SLOW_DISK,
    STALLED,
    STAYS_DAMAGED,
    STILL_HELD,
    UNMOVED,
    Aborted,
    Fault,
    classify_fault,
    make_beam_fault,
    make_held_fault,
    make_silence_fault,
    make_target_fault,
    make_unable_fault,
    make_unfound_fault,
)
from truepath.app.measurement.measurement_state import HoldReason, MeasurementState
from truepath.app.measurement.messages import CellState, ReportEvent
from truepath.app.measurement.point_reader import PointReader
from truepath.app.measurement.progress import LiveView, ProgressEstimator, RowSchedule
from truepath.app.measurement.recorder import Recorder
from truepath.app.measurement.stream_reader import StreamReader, StreamState
from truepath.app.measurement.target_check import (
    BOUND_MM,
    TargetCheck,
)
from truepath.app.measurement.target_search import SearchStep, TargetSearch
from truepath.app.measurement.timing import EngineSettings, Stopwatch
from truepath.app.measurement.tracker_task import TrackerTask
from truepath.drivers.interfaces.errors import (
    BeamLost,
    ConnectionLost,
    DeviceError,
    DeviceTimeout,
    NotHomed,
    NotOffered,
)
from truepath.drivers.interfaces.motion import MotionController
from truepath.drivers.interfaces.records import (
    UNABLE,
    MotionState,
    MotionStatus,
)
from truepath.drivers.interfaces.tracker import (
    AnyTracker,
    EventSource,
    PolledTracker,
    TargetChoice,
    TargetFinder,
    Tracker,
)
from truepath.drivers.interfaces.tracker_records import Clock

_CHOICE_S = 30.0  # a driver gives up before
_TICKS_HIT = 12  # looks, a tenth of a second each, over which damage is noticed late


class MeasurementMonitor:
    """Stream, controller, disk and progress of one measurement under way.

    `is_beam_good` and `report_fault` are for any thread; everything else belongs to the
    thread of the engine.
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
        targets: TargetCheck | None = None,
        search: TargetSearch | None = None,
    ) -> None:
        self.settings, self.clock = settings, settings.clock
        self.progress = ProgressEstimator(schedule, settings.progress_s, settings.clock)
        self._tracker, self.motion, self.recorder = tracker, motion, recorder
        self.state, self._view, self.report = state, view, report
        self._machine = ControllerMonitor(motion, recorder, settings)
        self._stream: StreamReader | None = None
        self._targets = targets  # where there are several
        self._search = search  # where the tracker can
        self._lost_row: int | None = None
        self._is_choosing, self._chooses = False, True
        self._is_homed = False
        self._failures = 0  # of a polled tracker, one after another
        self._point_s = 0.0
        self._is_machine_hold_reported = self._is_unmoved_told = False
        self._damaged = Stopwatch(settings.clock)
        self._rows: deque[int] = deque(maxlen=_TICKS_HIT)
        self._hit_row: int | None = None
        self._unmoved = Stopwatch(settings.clock)
        self._here: tuple[float, ...] = ()
        self._unconfirmed_hold = Stopwatch(settings.clock)
        self._unconfirmed_resume = Stopwatch(settings.clock)

    def begin_stream(self, rate_hz: float) -> None:
        """Start the stream; return at its first valid sample, or raise Fault."""
        if isinstance(self._tracker, PolledTracker):
            raise POINTS_ONLY
        stream = self._stream = StreamReader(
            self._tracker, self.recorder, self.settings.timeouts, self.clock
        )
        try:
            stream.start(rate_hz)
        except NotHomed as error:
            self._home(error)
            stream.start(rate_hz)
        deadline_s = self.clock() + self.settings.first_sample_s
        while not stream.has_valid:
            if self.clock() > deadline_s:
                if stream.device_time_s is None:
                    raise make_silence_fault(self.settings.first_sample_s)
                text = "the tracker sends no valid sample"
                action = "lock the beam on the reflector, then measure again"
                raise Fault("beam-lost", text, action, latched=False)
            self.tick()

    def end_stream(self) -> None:
        """End the stream and record what waits. Idempotent, never raises."""
        if self._stream is not None:
            try:
                self._stream.stop()
            except DeviceError as error:
                self._record_event("tracker", str(error))
        self._machine.flush()

    def take_hit_row(self) -> int | None:
        """Return the first row since the last call with a damaged stream, if any."""
        row, self._hit_row = self._hit_row, None
        return row

    @property
    def is_polled(self) -> bool:
        """Whether the tracker measures point by point, and there is no stream."""
        return isinstance(self._tracker, PolledTracker)

    @property
    def stamps_arrival(self) -> bool:
        """Whether samples bear the time of their arrival, which blurs all motion."""
        tracker = self._tracker
        return isinstance(tracker, Tracker) and tracker.capabilities.clock is Clock.HOST

    @property
    def can_choose(self) -> bool:
        """Whether the tracker goes from target to target by itself, as far as known."""
        return self._chooses and isinstance(self._tracker, TargetChoice)

    def select_target(self, name: str) -> bool:
        """Have the tracker choose its target; tell whether it is chosen.

        One that cannot choose measures what it is aimed at: the check of its points
        asks for another where that is needed.
        """
        if not (self._chooses and isinstance(self._tracker, TargetChoice)):
            return True
        tracker = self._tracker
        failure = self._await(lambda: tracker.select_target(name))
        if isinstance(failure, NotOffered):
            self._chooses = False
            self._record_event("target", str(failure))
        elif isinstance(failure, NotHomed):
            self._home(failure)
            return False
        elif failure is not None:
            self._bear(failure)
            return False
        else:
            self._record_event("target", f"{name} was selected")
        return True

    def _await(self, verb: Callable[[], None]) -> Exception | None:
        """Look on while the tracker does something; return why it was not done."""
        task, late_s = TrackerTask(verb), self.clock() + _CHOICE_S
        self._is_choosing = True
        try:
            while not task.is_over:
                self.tick()
                if self.clock() > late_s:
                    raise make_silence_fault(_CHOICE_S)
        finally:
            self._is_choosing = False
        return task.failure

    def _home(self, refusal: NotHomed) -> None:
        """Home a tracker that asks for it, once; that moves no machine."""
        if self._is_homed or not isinstance(self._tracker, TargetFinder):
            raise classify_fault(refusal) from refusal
        self._is_homed = True
        failure = self._await(self._tracker.home)
        if failure is not None:
            raise classify_fault(failure) from failure
        self.report_fault(HOMED)

    def holds_target(self, name: str, place_mm: NDArray[np.float64] | None) -> bool:
        """Tell whether a point is of this target; hold and say so if it is not.

        place_mm : the newest of the stream where left out
        """
        if place_mm is None and self._stream is not None:
            place_mm = self._stream.place_mm
        if self._targets is None or not name or place_mm is None:
            return True
        here = dict(zip(self.motion.axes, self._machine.position, strict=True))
        misfit_mm = self._targets.measure_misfit(here, name, place_mm)
        if misfit_mm > BOUND_MM:
            self._hold_feed(HoldReason.TARGET, make_target_fault(name, misfit_mm))
        return misfit_mm <= BOUND_MM

    def measure_point(self, row: int, dwell_s: float, target: str = "") -> bool:
        """Measure a point that the machine stands at and record it.

        Tells whether it was; else the machine moved, the feed is held, or the tracker
        was out of reach. Raises Fault once that was so too often.
        """
        if not isinstance(self._tracker, PolledTracker):
            raise POINTS_ONLY
        late_s = self.clock() + dwell_s + self.settings.timeouts.point_s
        self.tick()
        here, stood = self._machine.position, True
        reader = PointReader(self._tracker, dwell_s)
        try:
            while stood and not reader.is_over:
                stood = self._stands(self.tick(), here)
                if self.clock() > late_s:
                    raise make_silence_fault(dwell_s + self.settings.timeouts.point_s)
        finally:
            reader.stop()
        if not stood or not self._stands(self.tick(), here):
            self._record_event("point", f"row {row + 1}: moved while it was measured")
            return False
        if reader.failure is not None:
            self._bear(reader.failure)
            return False
        if not self.holds_target(target, reader.point.position_mm):
            return False
        if self._search is not None:
            axes = dict(zip(self.motion.axes, here, strict=True))
            self._search.remember(axes, target, reader.point.position_mm, stands=True)
        self.recorder.put_point(row, reader.point, reader.take_link_bytes())
        self._failures, self._point_s = 0, reader.point.time_s
        return True

    @property
    def position(self) -> tuple[float, ...]:
        """Of every axis at the last reading."""
        return self._machine.position

    def is_at(self, position: NDArray[np.float64]) -> bool:
        """Whether every axis was at its commanded position at the last reading."""
        away = np.abs(np.subtract(self._machine.position, position))
        return bool((away <= self.settings.arrival).all())

    def _stands(self, status: MotionStatus | None, here: tuple[float, ...]) -> bool:
        """Whether the machine is where it was, and may be measured there."""
        away = np.abs(np.subtract(self._machine.position, here))
        is_running = status is not None and status.state is MotionState.RUNNING
        return not is_running and bool((away <= self.settings.arrival).all())

    def _bear(self, failure: Exception) -> None:
        """Hold the feed where the beam is lost; connect anew where the link is."""
        if isinstance(failure, BeamLost):
            self._hold_feed(HoldReason.BEAM, make_beam_fault(str(failure)))
            return
        self._failures += 1
        if (
            not isinstance(failure, ConnectionLost | DeviceTimeout)
            or self._failures > self.settings.point_tries
        ):
            raise classify_fault(failure) from failure
        self._record_event("tracker", str(failure))
        if isinstance(failure, ConnectionLost):
            with contextlib.suppress(ConnectionLost, DeviceTimeout):
                self._tracker.connect()

    @property
    def device_s(self) -> float:
        """The tracker's clock at its newest sample or point, 0 before the first."""
        return (self._stream and self._stream.device_time_s) or self._point_s

    @property
    def is_beam_good(self) -> bool:
        """Whether a stream under way brings valid samples; true where there is none."""
        return self._stream is None or self._stream.assess() is StreamState.GOOD

    def tick(self) -> MotionStatus | None:
        """Wait a tenth of a second, then check everything.

        Returns the controller's status, None if it did not answer this time. Raises
        Aborted, or Fault.
        """
        if self.state.aborted.wait(self.settings.poll_s):
            raise Aborted("aborted on request")
        self._check_disk()
        self._tell_events()
        self._check_stream()
        here, status = self._machine.position, self._machine.poll()
        if status is not None:
            self._apply_status(status)
            if self._search is not None:
                self._follow_target(self._search, stands=status.position == here)
        self._report_progress()
        return status

    def report_fault(self, fault: Fault) -> None:
        """Report and record a fault that the measurement may survive."""
        self._record_event(fault.code, fault.text)
        self.report(fault.event)

    def _check_disk(self) -> None:
        if self.recorder.failure or self.recorder.is_space_low:
            text = self.recorder.failure or "the disk is almost full"
            action = "free some space, then measure again"
            raise Fault("storage", text, action, latched=False)
        if self.recorder.is_strained:
            self._hold_feed(HoldReason.DISK, SLOW_DISK)
        elif self.recorder.is_relaxed and HoldReason.DISK in self.state.holds:
            self._release_hold(HoldReason.DISK, "the disk has caught up")

    def _check_stream(self) -> None:
        if self._stream is None:
            return
        if self._stream.failure is not None:
            raise classify_fault(self._stream.failure)
        state = self._stream.assess()
        if state is StreamState.DEAD:
            raise make_silence_fault(self.settings.timeouts.dead_s)
        if state is StreamState.SILENT:
            self._hold_feed(HoldReason.SILENCE, SILENT)
        elif state is StreamState.BEAM_LOST and not self._is_choosing:
            self._hold_feed(HoldReason.BEAM, BEAM_LOST)
            if self._lost_row is None and self.progress.stage == "measuring":
                self._lost_row = self._rows[0]
        elif state is StreamState.GOOD:
            # Too short for anybody to have walked up to the machine: go on by itself.
            for reason in {HoldReason.SILENCE, HoldReason.DAMAGE} & self.state.holds:
                self._release_hold(reason, "the stream is good again")
        self._follow_damage(is_damaged=state is StreamState.DAMAGED)

    def _follow_damage(self, *, is_damaged: bool) -> None:
        """Hold while the stream is damaged; keep the row that it began in."""
        self._rows.append(self.progress.row)
        if not is_damaged:
            self._damaged.reset()
            return
        self._hold_feed(HoldReason.DAMAGE, DAMAGED)
        if self.progress.stage == "measuring" and self._hit_row is None:
            self._hit_row = self._rows[0]
        if self._damaged.measure_s() > self.settings.timeouts.damaged_s:
            raise STAYS_DAMAGED

    def _follow_target(self, search: TargetSearch, *, stands: bool) -> None:
        """Remember where the target is; have the tracker find one that is lost."""
        here = dict(zip(self.motion.axes, self._machine.position, strict=True))
        name, point = self.progress.target, self.progress.point
        if HoldReason.BEAM not in self.state.holds:
            search.forget()
            self._lost_row = None
            place_mm = self._see()
            if place_mm is not None:
                search.remember(here, name, place_mm, stands=stands)
        elif self.state.state is CellState.PAUSED:
            see = None if self.is_polled else self._see
            key = -1 if point is None else point
            step = search.advance(here, name, key, see)
            if step is not None:
                self._tell_search(step)

    def _see(self) -> NDArray[np.float64] | None:
        """Return where the stream has the target now, None while it is not seen."""
        stream = self._stream
        if stream is None or stream.assess() is not StreamState.GOOD:
            return None
        return stream.place_mm if stream.is_seen else None

    def _tell_search(self, step: SearchStep) -> None:
        """Record a try; go on where it has found, and drive the lost line again."""
        self._record_event("found" if step.has_found else "search", step.text)
        if step.has_found:
            if self.progress.point is None and self._hit_row is None:
                self._hit_row = self._lost_row
            self._release_hold(HoldReason.BEAM, "the target was found again")
        elif step.is_last:
            self.report_fault(make_unfound_fault(step.text))

    def _tell_events(self) -> None:
        """Record what happens at the tracker; report what somebody has to look at."""
        if not isinstance(self._tracker, EventSource):
            return
        for event in self._tracker.take_events():
            if event.action:
                fault = Fault(event.kind, event.text, event.action, latched=False)
                self.report_fault(fault)
            else:
                self._record_event(event.kind, event.text)

    def _hold_feed(self, reason: HoldReason, fault: Fault) -> None:
        if self.state.hold(reason, fault.text):
            self.report_fault(fault)
            self._machine.command(self.motion.hold)

    def _release_hold(self, reason: HoldReason, text: str) -> None:
        self._record_event("storage" if reason is HoldReason.DISK else "stream", text)
        self._is_machine_hold_reported = False  # it may be the only reason left
        self.state.release(reason, text=text)

    def _apply_status(self, status: MotionStatus) -> None:
        if status.state in UNABLE:
            raise make_unable_fault(status, latched=True)
        self._view.axes = status.position
        self.progress.follow(status.line)
        self.progress.pass_time(active=self.state.state is CellState.RUNNING)
        self.state.observe(status.state, status.hold_reason)
        self._report_machine_hold(status.hold_reason)
        self._look_for_motion(status)
        if self.state.wants_hold and status.state is MotionState.RUNNING:
            self._insist_on_hold()
        else:
            self._unconfirmed_hold.reset()
        self._insist_on_resume(status)

    def _look_for_motion(self, status: MotionStatus) -> None:
        """Tell once of a machine that says it runs, and moves no further."""
        is_stuck = status.state is MotionState.RUNNING and status.position == self._here
        self._here = status.position
        if not is_stuck:
            self._unmoved.reset()
            self._is_unmoved_told = False
            return
        stalled = status.override == 0.0
        # A machine that dwells does not move either; one at 0 % does not dwell.
        patience_s = 0.0 if stalled else self.progress.longest_row_s
        late = self._unmoved.measure_s() > self.settings.stuck_s + patience_s
        if late and not self._is_unmoved_told:
            self._is_unmoved_told = True
            self.report_fault(STALLED if stalled else UNMOVED)

    def _report_machine_hold(self, hold_reason: str) -> None:
        """Report once that somebody has to release the machine itself."""
        waits = HoldReason.MACHINE in self.state.holds
        if waits and not self._is_machine_hold_reported:
            self.report_fault(make_held_fault(hold_reason))
        self._is_machine_hold_reported = waits

    def _insist_on_hold(self) -> None:
        self._machine.command(self.motion.hold)
        if self._unconfirmed_hold.measure_s() > self.settings.confirm_s:
            raise Fault(
                "hold-unconfirmed",
                f"the machine moves {self.settings.confirm_s:g} s after a hold",
                "press feed hold at the machine",
                latched=True,
            )

    def _insist_on_resume(self, status: MotionStatus) -> None:
        if self.state.state is not CellState.RESUMING:
            self._unconfirmed_resume.reset()
            return
        self._machine.command(self.motion.resume)
        if self._unconfirmed_resume.measure_s() > self.settings.confirm_s:
            self.report_fault(STILL_HELD)
            self.state.fall_back(f"still held: {status.hold_reason}")
            self._is_machine_hold_reported = True

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

    def _record_event(self, kind: str, text: str) -> None:
        with contextlib.suppress(MeasurementFailed):
            self.recorder.event(kind, text)
