"""The two ways to measure and their steps: a path under a running stream, or points.

All waiting of a measurement happens in the `tick` of its monitor, which every step that
waits calls again and again.
"""

from __future__ import annotations

import contextlib
import queue
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truepath.app.measurement.axis_order import arrange_axes
from truepath.app.measurement.faults import (
    NO_BEAM,
    NO_TIMES,
    POINTS_ONLY,
    SERVICE_SILENT,
    STAYS_DAMAGED,
    UNSTOPPED,
    make_ended_early_fault,
    make_runs_on_fault,
)
from truepath.app.measurement.measurement_monitor import MeasurementMonitor
from truepath.app.measurement.measurement_state import HoldReason
from truepath.app.measurement.messages import (
    CellVerb,
    LinesDamaged,
    MeasurementCommand,
    MeasurementOrder,
    PartRequested,
)
from truepath.app.measurement.progress import schedule_rows
from truepath.app.motion.by_target import Stretch, cut_by_target
from truepath.app.motion.configurations import Commanded, Configurations, append_part
from truepath.app.motion.driven_again import drive_again
from truepath.app.motion.travel import check_travel
from truepath.drivers.interfaces.errors import ConnectionLost, DeviceTimeout
from truepath.drivers.interfaces.records import UNABLE, MotionState, MotionStatus, Path

_STANDING = frozenset(MotionState) - {
    MotionState.RUNNING,
    MotionState.HELD,
    *UNABLE,
}
_OVERSHOT = 1.0  # mm or deg; no servo goes so far beyond the end of a path
_AGAIN = 3  # times that lines are driven again: a measurement has to end


@dataclass(frozen=True, slots=True)
class LastLine:
    """The line at whose end a motion ends.

    number : of its row, as the controller counts
    begin, end : positions of the axes
    """

    number: int
    begin: NDArray[np.float64]
    end: NDArray[np.float64]

    def is_before(self, status: MotionStatus) -> bool:
        """Whether the machine runs on an earlier line, or it is the only one."""
        return self.number == 0 or (
            status.state is MotionState.RUNNING and status.line < self.number
        )

    def is_left(self, status: MotionStatus) -> bool:
        """Whether the machine runs on it, or says so, and is somewhere else."""
        if status.state is not MotionState.RUNNING or status.line < self.number:
            return False
        low, high = np.sort([self.begin, self.end], axis=0)
        here = np.array(status.position)
        return bool(((here < low - _OVERSHOT) | (here > high + _OVERSHOT)).any())


class MeasurementSteps:
    """The steps of one measurement under way.

    Any thread may call `obey`; everything else belongs to the thread of the engine.
    """

    def __init__(
        self,
        monitor: MeasurementMonitor,
        order: MeasurementOrder,
        start: tuple[float, ...],
    ) -> None:
        self.motion, self.settings = monitor.motion, monitor.settings
        self._monitor, self._order, self._start = monitor, order, start
        self._progress, self._clock = monitor.progress, monitor.clock
        self._recorder, self._state = monitor.recorder, monitor.state
        self._commanded = order.commanded
        self._parts: queue.SimpleQueue[Commanded] = queue.SimpleQueue()
        self.is_concluding = False  # the rest is to be left out
        self._concluded_row: int | None = None
        self._again_left = _AGAIN
        self._target = ""  # that the tracker was told to measure
        self._end: NDArray[np.float64] | None = None  # where the last motion ended

    @property
    def has_repeated(self) -> bool:
        """Whether lines were driven again."""
        return self._again_left < _AGAIN

    def run(self, commanded: Commanded) -> None:
        """Make the whole measurement; the rows are in the controller's axes."""
        if isinstance(commanded, Path):
            if self._monitor.is_polled:
                raise POINTS_ONLY
            if self._monitor.stamps_arrival:
                raise NO_TIMES
            self._stream_path(commanded)
        else:
            self._step_through(commanded)

    def _stream_path(self, path: Path) -> None:
        """Stand at the first row, load the path, stream from before it to after it.

        The controller keeps time. The stream begins and ends at a standstill, as
        segmentation needs it. It goes on while further parts are loaded and driven.
        """
        is_one = len(set(path.target)) == 1 or self._monitor.can_choose
        self.approach(path.position[0], *(path.target[:1] if is_one else ()))
        first, *rest = self._cut(path)
        self.motion.load(first.path)
        self.open_stream()
        self.run_path(first.path)
        self._drive(rest, 0)
        while isinstance(part := self._choose_part(), Path):
            self._drive(self._cut(part), self._progress.first_row)
        self.finish()

    def _cut(self, part: Path) -> list[Stretch]:
        """Return what is loaded at once: a target each, where the tracker can choose.

        Else the tracker is turned by hand while the controller dwells.
        """
        if self._monitor.can_choose:
            return cut_by_target(part)
        return [Stretch(0, part)]

    def _drive(self, stretches: Sequence[Stretch], part_row: int) -> None:
        """Drive them one after another; the tracker changes its target between.

        part_row : the first row of their part
        """
        for stretch in stretches:
            if self._progress.is_cut_short:
                return
            if self._monitor.can_choose:
                self._change_target(*stretch.path.target[:1])
            self.motion.load(stretch.path)
            self._progress.expect(part_row + stretch.row)
            self.run_path(stretch.path)

    def _change_target(self, name: str = "") -> None:
        """Have the tracker measure this target from here on; check that it does."""
        if name in ("", self._target):
            return
        self.record_for(self.settings.settle_s)
        self._monitor.holds_target(self._target, None)
        while self._target != name:
            self._choose_target(name)
            self.record_for(self.settings.settle_s)
            if not self._monitor.holds_target(name, None):
                self._target = ""
                self.checkpoint()

    def _choose_part(self) -> Commanded | None:
        """Return what comes next: lines with a damaged stream again, or a new part."""
        row = self._monitor.take_hit_row()
        if row is None or self.is_concluding:
            return self.request_part()
        self._again_left -= 1
        if self._again_left < 0:
            raise STAYS_DAMAGED
        first = max(row, 1)
        self._recorder.event("again", f"from row {first + 1} on")
        if self._order.grows:
            self._monitor.report(LinesDamaged(first, None))
            return self.request_part()
        again = drive_again(self._commanded, first)
        self._monitor.report(LinesDamaged(first, again))
        return self._extend(again)

    def _step_through(self, points: Configurations) -> None:
        """Stand at every point in turn while the stream runs, then at further ones.

        A tracker that is polled measures once the machine stands; there is no stream.
        Dwells are counted on the tracker's clock. A pause prolongs the standstill.
        """
        self.approach(points.position[0], *points.target[:1])
        self.open_stream()
        part: Commanded | None = points
        while isinstance(part, Configurations):
            if not self._stand_at_each(part, is_there=part is points):
                break
            part = self.request_part()
        self.finish()

    def _stand_at_each(self, points: Configurations, *, is_there: bool) -> bool:
        """Stand at every point; tell whether none was left out.

        is_there : the machine stands at the first one already
        """
        for row, position in enumerate(points.position):
            self._progress.begin(self._progress.first_row + row)
            name = points.target[row] if points.target else ""
            if row > 0 or not is_there:
                self.approach(position, name)
            if self._monitor.is_polled:
                self._poll_point(position, float(points.dwell_s[row]), name)
            else:
                self._record_point(position, float(points.dwell_s[row]), name)
            until_s = f"until {self._monitor.device_s:.6f} s"
            self._recorder.event("point", f"row {self._progress.row + 1} {until_s}")
            if self.is_concluding and row + 1 < len(points):
                self.leave_out_rest()
                return False
        return True

    def _choose_target(self, name: str) -> None:
        """Have the tracker measure this target, if it is another one."""
        if name in ("", self._target):
            return
        while not self._monitor.select_target(name):
            self.checkpoint()
        self._target = name

    def _record_point(
        self, position: NDArray[np.float64], dwell_s: float, name: str
    ) -> None:
        """Stand while the stream runs, until it has been there, of the right target."""
        span_s = self.settings.settle_s + dwell_s
        while not (
            self.record_for(span_s, position) and self._monitor.holds_target(name, None)
        ):
            self.checkpoint()
            self.wait_motion(position)

    def _poll_point(
        self, position: NDArray[np.float64], dwell_s: float, name: str
    ) -> None:
        """Let the tracker measure where the machine stands, until it has and stood."""
        is_measured = False
        while not is_measured:
            self.checkpoint()
            self.wait_motion(position)
            begin_s = self._clock()
            while self._clock() - begin_s < self.settings.settle_s:
                self._monitor.tick()
            is_measured = self._monitor.measure_point(self._progress.row, dwell_s, name)

    def approach(self, position: NDArray[np.float64], target: str = "") -> None:
        """Move straight to a position and wait there.

        target : that the tracker is to measure there; it changes to it on the way
        """
        self.checkpoint()
        begin = self._monitor.position
        self.motion.move_to(tuple(map(float, position)), self._order.feed_mm_min)
        self._choose_target(target)
        self.wait_motion(position, LastLine(0, np.array(begin), position))

    def open_stream(self) -> None:
        """Start the tracker's stream and record `lead_s` of it before any motion."""
        if not self._monitor.is_polled:
            self._monitor.begin_stream(self._order.rate_hz)
            self.record_for(self.settings.lead_s)

    def run_path(self, path: Path) -> None:
        """Start the loaded path and follow it to its end."""
        self.checkpoint()
        self._progress.begin(self._progress.first_row)
        self._recorder.event("start", "cycle start")
        self.motion.start()
        last = LastLine(len(path) - 1, path.position[-2:][0], path.position[-1])
        self.wait_motion(last.end, last, lambda now: self._is_line_done(now, path))

    def wait_motion(
        self,
        goal: NDArray[np.float64],
        last: LastLine | None = None,
        may_end: Callable[[MotionStatus], bool] = lambda _: False,
    ) -> None:
        """Wait until the machine stands where it was sent.

        last : on which it comes there, if it moves by our order
        may_end : tells for a status whether the rest is to be left out now

        Raises Fault if it stands elsewhere, or moves on from there.
        """
        grace_by_s = self._clock() + self.settings.confirm_s
        self._end, has_begun = goal, False
        while True:
            status = self._monitor.tick()
            if last is not None and status is not None:
                # At first a controller may show the last line of its program before.
                has_begun = has_begun or last.is_before(status)
                if has_begun and last.is_left(status):
                    raise make_runs_on_fault(self.motion.axes, status)
            if status is not None and may_end(status):
                self._end_motion()
                return
            if (
                status is None
                or status.state not in _STANDING
                or self._state.must_stand
            ):
                if status is not None and status.state is MotionState.RUNNING:
                    grace_by_s = self._clock() + 10 * self.settings.poll_s
                continue
            if self._monitor.is_at(goal):
                return
            if status.state is MotionState.ABORTED or self._clock() > grace_by_s:
                raise make_ended_early_fault(self.motion.axes, status, goal)

    def record_for(
        self, device_s: float, at: NDArray[np.float64] | None = None
    ) -> bool:
        """Stand and let the stream run for so long on the tracker's clock.

        After a pause it starts over: what came before may lack the beam. Tells whether
        the machine stood there all the time, where a position is given.
        """
        begin_s = self._monitor.device_s
        while self._monitor.device_s - begin_s < device_s:
            self._monitor.tick()
            if self._state.must_stand:
                self.checkpoint()
                begin_s = self._monitor.device_s
            if at is not None and not self._monitor.is_at(at):
                row = self._progress.row + 1
                self._recorder.event("point", f"row {row}: moved while it was measured")
                return False
        return True

    def checkpoint(self) -> None:
        """Stand here for as long as a hold lasts."""
        self._monitor.tick()
        while self._state.must_stand:
            self._monitor.tick()

    def request_part(self) -> Commanded | None:
        """Stand until there is a further part; check and record it.

        Returns it in the controller's axes, None if enough is known.
        """
        part = self._wait_for_part() if self._order.grows else None
        if part is None:
            return None
        return self._extend(part)

    def _extend(self, part: Commanded) -> Commanded:
        """Check and record a part; return it in the controller's axes."""
        check_travel(self._order.machine, part)
        self._commanded = append_part(self._commanded, part)
        self._recorder.extend(self._commanded)
        schedule = schedule_rows(self._commanded, self._order.feed_mm_min)
        self._progress.extend(schedule)
        return arrange_axes(part, self.motion.axes, self._start)

    def _wait_for_part(self) -> Commanded | None:
        if not self.is_concluding and not self._monitor.is_polled:
            self.record_for(self.settings.settle_s)  # the data of the last row go first
        if not self.is_concluding:
            self._monitor.report(PartRequested(self._progress.row))
        while not self.is_concluding:
            self._tick_at_end()
            if not self._state.must_stand and not self._parts.empty():
                return self._parts.get_nowait()
        return None

    def finish(self) -> None:
        """Record `lead_s` after the last motion."""
        self._progress.end()
        begin_s = self._monitor.device_s
        while (
            not self._monitor.is_polled
            and self._monitor.device_s - begin_s < self.settings.lead_s
        ):
            self._tick_at_end()

    def _tick_at_end(self) -> None:
        """Wait a moment where the last motion has ended. Raises Fault if it goes on."""
        status = self._monitor.tick()
        if status is None or self._end is None:
            return
        here = np.array(status.position)
        if self._state.must_stand:
            self._end = here  # somebody may move it by hand meanwhile
        elif (np.abs(here - self._end) > _OVERSHOT).any():
            raise make_runs_on_fault(self.motion.axes, status)

    def miss_service(self) -> None:
        """Hold until a person resumes: no pause or abort would have come through."""
        if self._state.hold(HoldReason.SERVICE, str(SERVICE_SILENT)):
            self._monitor.report_fault(SERVICE_SILENT)
            self.motion.hold()

    def obey(self, command: MeasurementCommand) -> None:
        """Do what the operator asks, as `CellVerb` states it."""
        match command:
            case CellVerb.PAUSE:
                if self._state.hold(HoldReason.OPERATOR, "pause"):
                    self.motion.hold()
            case CellVerb.RESUME if self._monitor.is_beam_good:
                self._state.release(*HoldReason, text="resume")
            case CellVerb.RESUME:
                self._monitor.report_fault(NO_BEAM)
            case CellVerb.CONCLUDE:
                self.is_concluding = True
            case Path() | Configurations():
                self._parts.put(command)
            case _:
                pass

    def leave_out_rest(self) -> None:
        """Record that the rest of the rows is not driven."""
        self._progress.is_cut_short = True
        text = f"row {self._progress.row + 1}: enough is known, the rest is left out"
        self._recorder.event("concluded", text)

    def _is_line_done(self, status: MotionStatus, path: Path) -> bool:
        """Tell whether the line that was under way at `conclude` has been driven."""
        moving = status.state is MotionState.RUNNING and not self._state.must_stand
        if not self.is_concluding or not moving:
            return False
        if self._concluded_row is None:
            self._concluded_row = status.line
        row = min(status.line, len(path) - 1)
        arrived = self._monitor.is_at(path.position[row])
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
                self._end = np.array(status.position)
                return
            if self._clock() > stand_by_s:
                raise UNSTOPPED
