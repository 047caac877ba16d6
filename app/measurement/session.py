"""The steps that every measurement is made of, and the watch kept during each.

All waiting of a measurement happens in `tick`: ten times a second it feeds the
controller's watchdog, reads the controller, judges the stream and the disk, and obeys
the operator. An engine that hangs therefore feeds nothing, and the machine holds.
"""

from __future__ import annotations

import contextlib
import queue
import threading
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from app.errors import MeasurementFailed
from app.measurement.control import Control, HoldReason
from app.measurement.faults import (
    BEAM_LOST,
    NO_BEAM,
    SILENT,
    SLOW_DISK,
    STILL_HELD,
    UNSTOPPED,
    Aborted,
    Fault,
    fault_of,
    tracker_dead,
)
from app.measurement.limits import Limits
from app.measurement.live_view import LiveView
from app.measurement.motion_watch import MotionWatch
from app.measurement.orders import CellState, Report
from app.measurement.parts import Commanded
from app.measurement.progress import Course, Schedule
from app.measurement.pump import Pump
from app.measurement.recorder import Recorder
from app.measurement.stream_watch import StreamWatch, Verdict
from drivers.interfaces.errors import ConnectionLost, DeviceError, DeviceTimeout
from drivers.interfaces.motion import MotionController
from drivers.interfaces.records import MotionState, MotionStatus, Path
from drivers.interfaces.tracker import Tracker

_STANDS = frozenset(
    {
        MotionState.IDLE,
        MotionState.READY,
        MotionState.FINISHED,
        MotionState.ABORTED,
    }
)


class Session:
    """One measurement under way, as its engine sees it.

    `pause` and `resume` may be called by any thread; everything else belongs to the
    thread of the engine.
    """

    def __init__(
        self,
        tracker: Tracker,
        motion: MotionController,
        recorder: Recorder,
        control: Control,
        view: LiveView,
        report: Report,
        schedule: Schedule,
        *,
        limits: Limits | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.motion, self.limits = motion, limits or Limits()
        self._tracker, self._recorder, self._control = tracker, recorder, control
        self._view, self._report, self._clock = view, report, clock
        self._course = Course(schedule, self.limits.progress_s, clock)
        self._machine = MotionWatch(motion, recorder, self.limits, clock)
        self._watch = StreamWatch(self.limits.patience, clock())
        self._pump: Pump | None = None
        self._resume_by_s: float | None = None
        self._hold_by_s: float | None = None
        self._parts: queue.SimpleQueue[Commanded] = queue.SimpleQueue()
        self._concluding = threading.Event()
        self._concluded_row: int | None = None

    # What an engine does.

    def approach(self, position: NDArray[np.float64], feed_mm_min: float) -> None:
        """Move straight to a position and wait there."""
        self.checkpoint()
        self.motion.move_to(tuple(float(v) for v in position), feed_mm_min)
        self.wait_motion(position)

    def open_stream(self, rate_hz: float) -> None:
        """Start the tracker's stream and record `lead_s` of it before any motion."""
        self._watch = StreamWatch(self.limits.patience, self._clock())
        self._pump = Pump(self._tracker, self._recorder, self._watch, self._clock)
        self._pump.start(rate_hz)
        deadline_s = self._clock() + self.limits.first_sample_s
        while not self._watch.has_valid:
            if self._clock() > deadline_s:
                raise self._no_stream()
            self.tick()
        self.record_for(self.limits.lead_s)

    def run_path(self, path: Path) -> None:
        """Start the loaded path and follow it to its end."""
        self.checkpoint()
        self._course.begin(self._course.first_row)
        self._recorder.event("start", "cycle start")
        self.motion.start()
        self.wait_motion(path.position[-1], lambda now: self._is_line_done(now, path))

    def wait_motion(
        self,
        goal: NDArray[np.float64],
        may_end: Callable[[MotionStatus], bool] = lambda _: False,
    ) -> None:
        """Wait until the machine stands where it was sent.

        may_end : tells while the machine moves whether the rest is to be left out

        Raises Fault if it stands elsewhere: the motion ended early.
        """
        grace_by_s = self._clock() + self.limits.confirm_s
        while True:
            status = self.tick()
            if status is not None and may_end(status):
                self._end_motion()
                return
            if status is None or status.state not in _STANDS or self._control.standing:
                if status is not None and status.state is MotionState.RUNNING:
                    grace_by_s = self._clock() + 10 * self.limits.poll_s
                continue
            away = np.abs(np.array(status.position) - goal)
            if (away <= self.limits.arrival).all():
                return
            if status.state is MotionState.ABORTED or self._clock() > grace_by_s:
                raise self._ended_early(status, goal)

    def record_for(self, device_s: float) -> None:
        """Stand and let the stream run for so long on the tracker's clock.

        After a pause it starts over: what came before may lack the beam.
        """
        begin_s = self._device_s()
        while self._device_s() - begin_s < device_s:
            self.tick()
            if self._control.standing:
                self.checkpoint()
                begin_s = self._device_s()

    def checkpoint(self) -> None:
        """Stand here for as long as the operator wishes."""
        self.tick()
        while self._control.standing:
            self.tick()

    def begin_row(self, row: int) -> None:
        """Note that the machine is sent to this row of its part now."""
        self._course.begin(self._course.first_row + row)

    def point_done(self, row: int) -> None:
        """Write down that a standstill point has been measured."""
        number = self._course.first_row + row + 1
        self._recorder.event("point", f"row {number} until {self._device_s():.6f} s")

    def wait_for_part(self) -> Commanded | None:
        """Stand and ask for a further part; None if enough is known."""
        if not self.is_concluding:
            self.record_for(self.limits.settle_s)  # what the last row told goes first
            self._report("part", {"row": self._course.row})
        while not self.is_concluding:
            self.tick()
            if not self._control.standing and not self._parts.empty():
                return self._parts.get_nowait()
        return None

    def add_rows(self, commanded: Commanded, schedule: Schedule) -> None:
        """Write down that more is commanded, the earlier rows included."""
        self._recorder.extend(commanded)
        self._course.extend(schedule)

    def finish(self) -> None:
        """Record `lead_s` after the last motion."""
        self._course.end()
        begin_s = self._device_s()
        while self._device_s() - begin_s < self.limits.lead_s:
            self.tick()

    def close_stream(self) -> None:
        """End the stream and hand over what waits. Idempotent, never raises."""
        if self._pump is not None:
            try:
                self._pump.stop()
            except DeviceError as error:
                self._note("tracker", str(error))
        self._machine.flush()

    # What anybody may wish.

    def pause(self) -> None:
        """Feed hold, now. The state is `paused` once the controller confirms."""
        if self._control.hold(HoldReason.OPERATOR, "pause"):
            self.motion.hold()

    def resume(self) -> None:
        """Go on after a pause, a lost beam or a hold at the machine."""
        if self._watch.verdict(self._clock()) is not Verdict.GOOD and self._pump:
            self._tell(NO_BEAM)
            return
        if self._control.release(*HoldReason, text="resume"):
            self.motion.resume()

    def extend(self, part: Commanded) -> None:
        """Go on with a further part, as soon as the machine stands and asks."""
        self._parts.put(part)

    def conclude(self) -> None:
        """Enough is known: finish the line or point under way, leave out the rest."""
        self._concluding.set()

    @property
    def is_concluding(self) -> bool:
        """Whether the rest is to be left out."""
        return self._concluding.is_set()

    def leave_out_rest(self) -> None:
        """Write down that the rest of the rows is not driven."""
        self._course.is_cut_short = True
        text = f"row {self._course.row + 1}: enough is known, the rest is left out"
        self._recorder.event("concluded", text)

    def _is_line_done(self, status: MotionStatus, path: Path) -> bool:
        """Tell whether the line that was under way at the wish has been driven."""
        moving = status.state is MotionState.RUNNING and not self._control.standing
        if not self.is_concluding or not moving:
            return False
        if self._concluded_row is None:
            self._concluded_row = status.line
        away = np.abs(np.array(status.position) - path.position[status.line])
        arrived = bool((away <= self.limits.arrival).all())
        return arrived or status.line > self._concluded_row

    def _end_motion(self) -> None:
        """Let the controller forget the rest of its path; wait until it stands."""
        self.leave_out_rest()
        stand_by_s = self._clock() + self.limits.confirm_s
        while True:
            with contextlib.suppress(ConnectionLost, DeviceTimeout):
                self.motion.abort()
            status = self.tick()
            if status is not None and status.state in _STANDS:
                return
            if self._clock() > stand_by_s:
                raise UNSTOPPED

    # The watch.

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
        verdict = self._watch.verdict(self._clock())
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
            self._tell(fault)
            self._machine.command(self.motion.hold)

    def _go_on_after(self, reason: HoldReason, text: str) -> None:
        self._note("stream" if reason is HoldReason.SILENCE else "storage", text)
        if self._control.release(reason, text=text):
            self._machine.command(self.motion.resume)

    def _follow(self, status: MotionStatus) -> None:
        if status.state is MotionState.ALARM:
            action = "clear the alarm at the machine, then measure again"
            text = f"the controller is in alarm: {status.alarm or 'no text'}"
            raise Fault("motion-alarm", text, action, latched=True)
        self._view.axes = status.position
        self._course.follow(status.line)
        self._course.pass_time(active=self._control.state is CellState.RUNNING)
        self._control.observe(status.state, status.hold_reason)
        if self._control.wants_hold and status.state is MotionState.RUNNING:
            self._insist_on_hold()
        else:
            self._hold_by_s = None
        self._insist_on_resume(status)

    def _insist_on_hold(self) -> None:
        self._machine.command(self.motion.hold)
        self._hold_by_s = self._hold_by_s or self._clock() + self.limits.confirm_s
        if self._clock() > self._hold_by_s:
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
        self._machine.command(self.motion.resume)
        self._resume_by_s = self._resume_by_s or self._clock() + self.limits.confirm_s
        if self._clock() > self._resume_by_s:
            self._tell(STILL_HELD)
            self._control.fall_back(f"still held: {status.hold_reason}")

    def _tell_progress(self) -> None:
        news = self._course.news()
        if news is None:
            return
        health = {
            "position": list(self._machine.position),
            "samples": self._recorder.samples,
            "lost_samples": self._recorder.lost_samples,
            "crc_errors": self._tracker.health.crc_errors,
        }
        self._report("progress", news | health)

    def _tell(self, fault: Fault) -> None:
        self._note(fault.code, fault.text)
        self._report(
            "fault", {"code": fault.code, "text": fault.text, "action": fault.action}
        )

    def _note(self, kind: str, text: str) -> None:
        with contextlib.suppress(MeasurementFailed):
            self._recorder.event(kind, text)

    def _device_s(self) -> float:
        return self._watch.device_time_s or 0.0

    def _no_stream(self) -> Fault:
        if self._watch.device_time_s is None:
            return tracker_dead(self.limits.first_sample_s)
        return Fault(
            "beam-lost",
            "the tracker sends no valid sample",
            "lock the beam on the reflector, then measure again",
            latched=False,
        )

    def _ended_early(self, status: MotionStatus, goal: NDArray[np.float64]) -> Fault:
        here = ", ".join(
            f"{axis} {value:.3f}"
            for axis, value in zip(self.motion.axes, status.position, strict=True)
        )
        there = ", ".join(f"{value:.3f}" for value in goal)
        return Fault(
            "ended-early",
            f"the controller is {status.state} at {here} (row {status.line + 1}), "
            f"not at {there}",
            "check which program ran at the machine",
            latched=True,
        )
