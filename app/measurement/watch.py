"""The watch kept while anything of a measurement waits.

Ten times a second it feeds the controller's watchdog, reads the controller, judges the
stream and the disk, and obeys the operator. An engine that hangs therefore feeds
nothing, and the machine holds.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from dataclasses import replace

from app.errors import MeasurementFailed
from app.measurement.control import Control, HoldReason
from app.measurement.faults import (
    BEAM_LOST,
    SILENT,
    SLOW_DISK,
    STILL_HELD,
    Aborted,
    Fault,
    fault_of,
    held_at_machine,
    tracker_dead,
)
from app.measurement.limits import Limits
from app.measurement.live_view import LiveView
from app.measurement.messages import CellState, ReportEvent
from app.measurement.motion_watch import MotionWatch
from app.measurement.progress import Course, Schedule
from app.measurement.pump import Pump
from app.measurement.recorder import Recorder
from app.measurement.running_clock import RunningClock
from app.measurement.stream_watch import StreamWatch, Verdict
from drivers.interfaces.errors import DeviceError
from drivers.interfaces.motion import MotionController
from drivers.interfaces.records import MotionState, MotionStatus
from drivers.interfaces.tracker import Tracker


class Watch:
    """Stream, controller, disk and progress of one measurement under way.

    `is_beam_good` and `tell` are for any thread; everything else belongs to the thread
    of the engine.

    course : where the measurement is on its schedule
    """

    def __init__(
        self,
        tracker: Tracker,
        motion: MotionController,
        recorder: Recorder,
        control: Control,
        view: LiveView,
        report: ReportEvent,
        schedule: Schedule,
        *,
        limits: Limits | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.limits, self.clock = limits or Limits(), clock
        self.course = Course(schedule, self.limits.progress_s, clock)
        self._tracker, self._motion, self._recorder = tracker, motion, recorder
        self._control, self._view, self._report = control, view, report
        self._machine = MotionWatch(motion, recorder, self.limits, clock)
        # A host that did not run has not listened either: that is no silence.
        self._ear = RunningClock(self.limits.patience.late_s, clock)
        self._stream = StreamWatch(self.limits.patience, self._ear())
        self._pump: Pump | None = None
        self._is_machine_told = False
        self._resume_by_s: float | None = None
        self._hold_by_s: float | None = None

    def begin_stream(self, rate_hz: float) -> None:
        """Start the stream; return at its first valid sample, or raise Fault."""
        self._stream = StreamWatch(self.limits.patience, self._ear())
        self._pump = Pump(self._tracker, self._recorder, self._stream, self._ear)
        self._pump.start(rate_hz)
        deadline_s = self.clock() + self.limits.first_sample_s
        while not self._stream.has_valid:
            if self.clock() > deadline_s:
                raise self._no_stream()
            self.tick()

    def end_stream(self) -> None:
        """End the stream and hand over what waits. Idempotent, never raises."""
        if self._pump is not None:
            try:
                self._pump.stop()
            except DeviceError as error:
                self._note("tracker", str(error))
        self._machine.flush()

    @property
    def device_s(self) -> float:
        """The tracker's clock, 0 before its first sample."""
        return self._stream.device_time_s or 0.0

    @property
    def is_beam_good(self) -> bool:
        """Whether a stream under way brings valid samples; true where there is none."""
        if self._pump is None:
            return True
        return self._stream.verdict(self._ear()) is Verdict.GOOD

    def tick(self) -> MotionStatus | None:
        """Wait a tenth of a second and look at everything.

        Returns the controller's status, None if it did not answer this time. Raises
        Aborted, or Fault.
        """
        if self._control.aborted.wait(self.limits.poll_s):
            raise Aborted("aborted on request")
        self._check_disk()
        self._check_stream()
        status = self._machine.look()
        if status is not None:
            self._follow(status)
        self._tell_progress()
        return status

    def tell(self, fault: Fault) -> None:
        """Report a fault that the measurement may survive, and write it down."""
        self._note(fault.code, fault.text)
        self._report(fault.event)

    def _check_disk(self) -> None:
        if self._recorder.failure or self._recorder.low_space:
            text = self._recorder.failure or "the disk is almost full"
            action = "free some space, then measure again"
            raise Fault("storage", text, action, latched=False)
        if self._recorder.strained:
            self._hold_for(HoldReason.DISK, SLOW_DISK)
        elif self._recorder.relaxed and self._control.holds(HoldReason.DISK):
            self._go_on_after(HoldReason.DISK, "the disk has caught up")

    def _check_stream(self) -> None:
        if self._pump is None:
            return
        if self._pump.failure is not None:
            raise fault_of(self._pump.failure)
        verdict = self._stream.verdict(self._ear())
        if verdict is Verdict.DEAD:
            raise tracker_dead(self.limits.patience.dead_s)
        if verdict is Verdict.SILENT:
            self._hold_for(HoldReason.SILENCE, SILENT)
        elif verdict is Verdict.BEAM_LOST:
            self._hold_for(HoldReason.BEAM, BEAM_LOST)
        elif self._control.holds(HoldReason.SILENCE):
            # Too short for anybody to have walked up to the machine: go on by itself.
            self._go_on_after(HoldReason.SILENCE, "the stream is back")

    def _hold_for(self, reason: HoldReason, fault: Fault) -> None:
        if self._control.hold(reason, fault.text):
            self.tell(fault)
            self._machine.command(self._motion.hold)

    def _go_on_after(self, reason: HoldReason, text: str) -> None:
        self._note("stream" if reason is HoldReason.SILENCE else "storage", text)
        self._is_machine_told = False  # what still holds is what to tell of now
        self._control.release(reason, text=text)

    def _follow(self, status: MotionStatus) -> None:
        if status.state is MotionState.ALARM:
            action = "clear the alarm at the machine, then measure again"
            text = f"the controller is in alarm: {status.alarm or 'no text'}"
            raise Fault("motion-alarm", text, action, latched=True)
        self._view.axes = status.position
        self.course.follow(status.line)
        self.course.pass_time(active=self._control.state is CellState.RUNNING)
        self._control.observe(status.state, status.hold_reason)
        self._tell_of_machine(status.hold_reason)
        if self._control.wants_hold and status.state is MotionState.RUNNING:
            self._insist_on_hold()
        else:
            self._hold_by_s = None
        self._insist_on_resume(status)

    def _tell_of_machine(self, hold_reason: str) -> None:
        """Say once that somebody has to release the machine itself."""
        waits = self._control.holds(HoldReason.MACHINE)
        if waits and not self._is_machine_told:
            self.tell(held_at_machine(hold_reason))
        self._is_machine_told = waits

    def _insist_on_hold(self) -> None:
        self._machine.command(self._motion.hold)
        self._hold_by_s = self._hold_by_s or self.clock() + self.limits.confirm_s
        if self.clock() > self._hold_by_s:
            raise Fault(
                "hold-unconfirmed",
                f"the machine moves {self.limits.confirm_s:g} s after a hold",
                "press feed hold at the machine",
                latched=True,
            )

    def _insist_on_resume(self, status: MotionStatus) -> None:
        if self._control.state is not CellState.RESUMING:
            self._resume_by_s = None
            return
        self._machine.command(self._motion.resume)
        self._resume_by_s = self._resume_by_s or self.clock() + self.limits.confirm_s
        if self.clock() > self._resume_by_s:
            self.tell(STILL_HELD)
            self._control.fall_back(f"still held: {status.hold_reason}")
            self._is_machine_told = True

    def _tell_progress(self) -> None:
        progress = self.course.news()
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

    def _note(self, kind: str, text: str) -> None:
        with contextlib.suppress(MeasurementFailed):
            self._recorder.event(kind, text)

    def _no_stream(self) -> Fault:
        if self._stream.device_time_s is None:
            return tracker_dead(self.limits.first_sample_s)
        return Fault(
            "beam-lost",
            "the tracker sends no valid sample",
            "lock the beam on the reflector, then measure again",
            latched=False,
        )
