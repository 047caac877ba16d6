"""Monitors stream, controller and disk while a measurement waits for anything.

Ten times a second it feeds the controller's watchdog, reads the controller, assesses
the stream and the disk, and applies what the operator asks for. An engine that hangs
feeds no watchdog, so the machine holds.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from dataclasses import replace

from app.errors import MeasurementFailed
from app.measurement.clocks import RunningClock, Stopwatch
from app.measurement.controller_monitor import ControllerMonitor
from app.measurement.engine_settings import EngineSettings
from app.measurement.faults import (
    BEAM_LOST,
    SILENT,
    SLOW_DISK,
    STILL_HELD,
    Aborted,
    Fault,
    classify_fault,
    make_held_fault,
    make_silence_fault,
)
from app.measurement.live_view import LiveView
from app.measurement.measurement_state import HoldReason, MeasurementState
from app.measurement.messages import CellState, ReportEvent
from app.measurement.progress import ProgressEstimator, RowSchedule
from app.measurement.recorder import Recorder
from app.measurement.stream_monitor import StreamMonitor, StreamState
from app.measurement.stream_reader import StreamReader
from drivers.interfaces.errors import DeviceError
from drivers.interfaces.motion import MotionController
from drivers.interfaces.records import MotionState, MotionStatus
from drivers.interfaces.tracker import Tracker


class MeasurementMonitor:
    """Stream, controller, disk and progress of one measurement under way.

    `is_beam_good` and `report_fault` are for any thread; everything else belongs to the
    thread of the engine.
    """

    def __init__(
        self,
        tracker: Tracker,
        motion: MotionController,
        recorder: Recorder,
        control: MeasurementState,
        view: LiveView,
        report: ReportEvent,
        schedule: RowSchedule,
        *,
        settings: EngineSettings | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.settings, self.clock = settings or EngineSettings(), clock
        self.progress = ProgressEstimator(schedule, self.settings.progress_s, clock)
        self._tracker, self._motion, self._recorder = tracker, motion, recorder
        self._control, self._view, self._report = control, view, report
        self._machine = ControllerMonitor(motion, recorder, self.settings, clock)
        # A process that did not run has not listened either: that is no silence.
        self._running_clock = RunningClock(self.settings.timeouts.late_s, clock)
        self._stream = StreamMonitor(self.settings.timeouts, self._running_clock())
        self._reader: StreamReader | None = None
        self._is_machine_hold_reported = False
        self._unconfirmed_hold = Stopwatch(clock)
        self._unconfirmed_resume = Stopwatch(clock)

    def begin_stream(self, rate_hz: float) -> None:
        """Start the stream; return at its first valid sample, or raise Fault."""
        self._stream = StreamMonitor(self.settings.timeouts, self._running_clock())
        self._reader = StreamReader(
            self._tracker, self._recorder, self._stream, self._running_clock
        )
        self._reader.start(rate_hz)
        deadline_s = self.clock() + self.settings.first_sample_s
        while not self._stream.has_valid:
            if self.clock() > deadline_s:
                raise self._make_no_stream_fault()
            self.tick()

    def end_stream(self) -> None:
        """End the stream and record what waits. Idempotent, never raises."""
        if self._reader is not None:
            try:
                self._reader.stop()
            except DeviceError as error:
                self._record_event("tracker", str(error))
        self._machine.flush()

    @property
    def device_s(self) -> float:
        """The tracker's clock, 0 before its first sample."""
        return self._stream.device_time_s or 0.0

    @property
    def is_beam_good(self) -> bool:
        """Whether a stream under way brings valid samples; true where there is none."""
        if self._reader is None:
            return True
        return self._stream.assess(self._running_clock()) is StreamState.GOOD

    def tick(self) -> MotionStatus | None:
        """Wait a tenth of a second, then check everything.

        Returns the controller's status, None if it did not answer this time. Raises
        Aborted, or Fault.
        """
        if self._control.aborted.wait(self.settings.poll_s):
            raise Aborted("aborted on request")
        self._check_disk()
        self._check_stream()
        status = self._machine.poll()
        if status is not None:
            self._apply_status(status)
        self._report_progress()
        return status

    def report_fault(self, fault: Fault) -> None:
        """Report and record a fault that the measurement may survive."""
        self._record_event(fault.code, fault.text)
        self._report(fault.event)

    def _check_disk(self) -> None:
        if self._recorder.failure or self._recorder.is_space_low:
            text = self._recorder.failure or "the disk is almost full"
            action = "free some space, then measure again"
            raise Fault("storage", text, action, latched=False)
        if self._recorder.is_strained:
            self._hold_feed(HoldReason.DISK, SLOW_DISK)
        elif self._recorder.is_relaxed and self._control.holds(HoldReason.DISK):
            self._release_hold(HoldReason.DISK, "the disk has caught up")

    def _check_stream(self) -> None:
        if self._reader is None:
            return
        if self._reader.failure is not None:
            raise classify_fault(self._reader.failure)
        state = self._stream.assess(self._running_clock())
        if state is StreamState.DEAD:
            raise make_silence_fault(self.settings.timeouts.dead_s)
        if state is StreamState.SILENT:
            self._hold_feed(HoldReason.SILENCE, SILENT)
        elif state is StreamState.BEAM_LOST:
            self._hold_feed(HoldReason.BEAM, BEAM_LOST)
        elif self._control.holds(HoldReason.SILENCE):
            # Too short for anybody to have walked up to the machine: go on by itself.
            self._release_hold(HoldReason.SILENCE, "the stream is back")

    def _hold_feed(self, reason: HoldReason, fault: Fault) -> None:
        if self._control.hold(reason, fault.text):
            self.report_fault(fault)
            self._machine.command(self._motion.hold)

    def _release_hold(self, reason: HoldReason, text: str) -> None:
        self._record_event(
            "stream" if reason is HoldReason.SILENCE else "storage", text
        )
        self._is_machine_hold_reported = False  # it may be the only reason left
        self._control.release(reason, text=text)

    def _apply_status(self, status: MotionStatus) -> None:
        if status.state is MotionState.ALARM:
            action = "clear the alarm at the machine, then measure again"
            text = f"the controller is in alarm: {status.alarm or 'no text'}"
            raise Fault("motion-alarm", text, action, latched=True)
        self._view.axes = status.position
        self.progress.follow(status.line)
        self.progress.pass_time(active=self._control.state is CellState.RUNNING)
        self._control.observe(status.state, status.hold_reason)
        self._report_machine_hold(status.hold_reason)
        if self._control.wants_hold and status.state is MotionState.RUNNING:
            self._insist_on_hold()
        else:
            self._unconfirmed_hold.reset()
        self._insist_on_resume(status)

    def _report_machine_hold(self, hold_reason: str) -> None:
        """Report once that somebody has to release the machine itself."""
        waits = self._control.holds(HoldReason.MACHINE)
        if waits and not self._is_machine_hold_reported:
            self.report_fault(make_held_fault(hold_reason))
        self._is_machine_hold_reported = waits

    def _insist_on_hold(self) -> None:
        self._machine.command(self._motion.hold)
        if self._unconfirmed_hold.measure_s() > self.settings.confirm_s:
            raise Fault(
                "hold-unconfirmed",
                f"the machine moves {self.settings.confirm_s:g} s after a hold",
                "press feed hold at the machine",
                latched=True,
            )

    def _insist_on_resume(self, status: MotionStatus) -> None:
        if self._control.state is not CellState.RESUMING:
            self._unconfirmed_resume.reset()
            return
        self._machine.command(self._motion.resume)
        if self._unconfirmed_resume.measure_s() > self.settings.confirm_s:
            self.report_fault(STILL_HELD)
            self._control.fall_back(f"still held: {status.hold_reason}")
            self._is_machine_hold_reported = True

    def _report_progress(self) -> None:
        progress = self.progress.next_report()
        if progress is not None:
            self._report(
                replace(
                    progress,
                    position=self._machine.position,
                    samples=self._recorder.samples,
                    lost_samples=self._recorder.lost_samples,
                    crc_errors=self._tracker.health.crc_errors,
                )
            )

    def _record_event(self, kind: str, text: str) -> None:
        with contextlib.suppress(MeasurementFailed):
            self._recorder.event(kind, text)

    def _make_no_stream_fault(self) -> Fault:
        if self._stream.device_time_s is None:
            return make_silence_fault(self.settings.first_sample_s)
        return Fault(
            "beam-lost",
            "the tracker sends no valid sample",
            "lock the beam on the reflector, then measure again",
            latched=False,
        )
