"""The steps that every measurement is made of.

All waiting of a measurement happens in the `tick` of its monitor, which every step that
waits calls again and again.
"""

from __future__ import annotations

import contextlib
import queue
import threading
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from app.measurement.faults import NO_BEAM, UNSTOPPED, Fault
from app.measurement.measurement_monitor import MeasurementMonitor
from app.measurement.measurement_state import HoldReason, MeasurementState
from app.measurement.messages import PartRequested, ReportEvent
from app.measurement.progress import RowSchedule
from app.measurement.recorder import Recorder
from app.motion.configurations import Commanded
from drivers.interfaces.errors import ConnectionLost, DeviceTimeout
from drivers.interfaces.motion import MotionController
from drivers.interfaces.records import MotionState, MotionStatus, Path

_STANDING = frozenset(
    {
        MotionState.IDLE,
        MotionState.READY,
        MotionState.FINISHED,
        MotionState.ABORTED,
    }
)


class MeasurementSteps:
    """The steps of one measurement under way.

    `pause`, `resume`, `extend` and `conclude` may be called by any thread; everything
    else belongs to the thread of the engine.
    """

    def __init__(
        self,
        monitor: MeasurementMonitor,
        motion: MotionController,
        recorder: Recorder,
        control: MeasurementState,
        report: ReportEvent,
    ) -> None:
        self.motion, self.settings = motion, monitor.settings
        self._monitor, self._progress, self._clock = (
            monitor,
            monitor.progress,
            monitor.clock,
        )
        self._recorder, self._control, self._report = recorder, control, report
        self._parts: queue.SimpleQueue[Commanded] = queue.SimpleQueue()
        self._concluding = threading.Event()
        self._concluded_row: int | None = None

    def approach(self, position: NDArray[np.float64], feed_mm_min: float) -> None:
        """Move straight to a position and wait there."""
        self.checkpoint()
        self.motion.move_to(tuple(float(v) for v in position), feed_mm_min)
        self.wait_motion(position)

    def open_stream(self, rate_hz: float) -> None:
        """Start the tracker's stream and record `lead_s` of it before any motion."""
        self._monitor.begin_stream(rate_hz)
        self.record_for(self.settings.lead_s)

    def run_path(self, path: Path) -> None:
        """Start the loaded path and follow it to its end."""
        self.checkpoint()
        self._progress.begin(self._progress.first_row)
        self._recorder.event("start", "cycle start")
        self.motion.start()
        self.wait_motion(path.position[-1], lambda now: self._is_line_done(now, path))

    def wait_motion(
        self,
        goal: NDArray[np.float64],
        may_end: Callable[[MotionStatus], bool] = lambda _: False,
    ) -> None:
        """Wait until the machine stands where it was sent.

        may_end : tells for a status whether the rest is to be left out now

        Raises Fault if it stands elsewhere: the motion ended early.
        """
        grace_by_s = self._clock() + self.settings.confirm_s
        while True:
            status = self._monitor.tick()
            if status is not None and may_end(status):
                self._end_motion()
                return
            if (
                status is None
                or status.state not in _STANDING
                or self._control.must_stand
            ):
                if status is not None and status.state is MotionState.RUNNING:
                    grace_by_s = self._clock() + 10 * self.settings.poll_s
                continue
            distance = np.abs(np.array(status.position) - goal)
            if (distance <= self.settings.arrival).all():
                return
            if status.state is MotionState.ABORTED or self._clock() > grace_by_s:
                raise self._make_ended_early_fault(status, goal)

    def record_for(self, device_s: float) -> None:
        """Stand and let the stream run for so long on the tracker's clock.

        After a pause it starts over: what came before may lack the beam.
        """
        begin_s = self._monitor.device_s
        while self._monitor.device_s - begin_s < device_s:
            self._monitor.tick()
            if self._control.must_stand:
                self.checkpoint()
                begin_s = self._monitor.device_s

    def checkpoint(self) -> None:
        """Stand here for as long as a hold lasts."""
        self._monitor.tick()
        while self._control.must_stand:
            self._monitor.tick()

    def begin_row(self, row: int) -> None:
        """Note that the machine moves to this row of its part now."""
        self._progress.begin(self._progress.first_row + row)

    def record_point(self, row: int) -> None:
        """Record that a standstill point has been measured."""
        number = self._progress.first_row + row + 1
        self._recorder.event(
            "point", f"row {number} until {self._monitor.device_s:.6f} s"
        )

    def wait_for_part(self) -> Commanded | None:
        """Stand and request a further part; None if enough is known."""
        if not self.is_concluding:
            self.record_for(self.settings.settle_s)  # the data of the last row go first
            self._report(PartRequested(self._progress.row))
        while not self.is_concluding:
            self._monitor.tick()
            if not self._control.must_stand and not self._parts.empty():
                return self._parts.get_nowait()
        return None

    def add_rows(self, commanded: Commanded, schedule: RowSchedule) -> None:
        """Record that more is commanded; the earlier rows are included."""
        self._recorder.extend(commanded)
        self._progress.extend(schedule)

    def finish(self) -> None:
        """Record `lead_s` after the last motion."""
        self._progress.end()
        begin_s = self._monitor.device_s
        while self._monitor.device_s - begin_s < self.settings.lead_s:
            self._monitor.tick()

    def pause(self) -> None:
        """Feed hold, now. The state is `paused` once the controller confirms."""
        if self._control.hold(HoldReason.OPERATOR, "pause"):
            self.motion.hold()

    def resume(self) -> None:
        """Go on after a pause, a lost beam or a hold at the machine."""
        if not self._monitor.is_beam_good:
            self._monitor.report_fault(NO_BEAM)
            return
        self._control.release(*HoldReason, text="resume")

    def extend(self, part: Commanded) -> None:
        """Go on with a further part once it has been requested."""
        self._parts.put(part)

    def conclude(self) -> None:
        """Finish the line or point under way, leave out the rest."""
        self._concluding.set()

    @property
    def is_concluding(self) -> bool:
        """Whether the rest is to be left out."""
        return self._concluding.is_set()

    def leave_out_rest(self) -> None:
        """Record that the rest of the rows is not driven."""
        self._progress.is_cut_short = True
        text = f"row {self._progress.row + 1}: enough is known, the rest is left out"
        self._recorder.event("concluded", text)

    def _is_line_done(self, status: MotionStatus, path: Path) -> bool:
        """Tell whether the line that was under way at `conclude` has been driven."""
        moving = status.state is MotionState.RUNNING and not self._control.must_stand
        if not self.is_concluding or not moving:
            return False
        if self._concluded_row is None:
            self._concluded_row = status.line
        distance = np.abs(np.array(status.position) - path.position[status.line])
        arrived = bool((distance <= self.settings.arrival).all())
        return arrived or status.line > self._concluded_row

    def _end_motion(self) -> None:
        """Let the controller forget the rest of its path; wait until it stands."""
        self.leave_out_rest()
        stand_by_s = self._clock() + self.settings.confirm_s
        while True:
            with contextlib.suppress(ConnectionLost, DeviceTimeout):
                self.motion.abort()
            status = self._monitor.tick()
            if status is not None and status.state in _STANDING:
                return
            if self._clock() > stand_by_s:
                raise UNSTOPPED

    def _make_ended_early_fault(
        self, status: MotionStatus, goal: NDArray[np.float64]
    ) -> Fault:
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
