"""Steps common to path and points: approach, wait, pause, extend, end.

All waiting of a measurement happens in the `tick` of its monitor, which every waiting
step calls repeatedly.
"""

from __future__ import annotations

import contextlib
import queue
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truepath.measurement.engine.measurement_monitor import MeasurementMonitor
from truepath.measurement.engine.tracker_control import TrackerControl
from truepath.measurement.faults import (
    NO_BEAM,
    SERVICE_SILENT,
    UNSTOPPED,
    Fault,
    make_ended_early_fault,
    make_runs_on_fault,
)
from truepath.measurement.measurement_state import HoldReason
from truepath.measurement.messages import (
    CellVerb,
    MeasurementCommand,
    MeasurementOrder,
    PartRequested,
)
from truepath.measurement.progress import schedule_rows
from truepath.motion.configurations import Commanded, Configurations, append_part
from truepath.motion.workspace import check_travel
from truepath_drivers import host_clock
from truepath_drivers.interfaces.errors import ConnectionLost, DeviceTimeout
from truepath_drivers.interfaces.records import UNABLE, MotionState, MotionStatus, Path

OVERSHOT = 1.0
"""mm or deg; largest overshoot of a servo beyond the end of a path."""


@dataclass(frozen=True, slots=True)
class LastLine:
    """The line at whose end a motion ends.

    number : of its row, as the controller counts
    begin, end : positions of the axes, or corners of the box around an arc
    """

    number: int
    begin: NDArray[np.float64]
    end: NDArray[np.float64]

    def is_before(self, status: MotionStatus) -> bool:
        """Whether the machine runs on an earlier line, or there is no earlier one."""
        return self.number == 0 or (
            status.state is MotionState.RUNNING and status.line < self.number
        )

    def is_overrun(self, status: MotionStatus) -> bool:
        """Whether the machine reports this line or a later one but is off it."""
        if status.state is not MotionState.RUNNING or status.line < self.number:
            return False
        low, high = np.sort([self.begin, self.end], axis=0)
        here = np.array(status.position)
        return bool(((here < low - OVERSHOT) | (here > high + OVERSHOT)).any())


_STANDING = frozenset(MotionState) - {
    MotionState.RUNNING,
    MotionState.HELD,
    *UNABLE,
}


class MeasurementSteps(ABC):
    """The steps of one active measurement, of a path or of points.

    Any thread may call `obey`; everything else belongs to the thread of the engine.
    """

    def __init__(
        self,
        monitor: MeasurementMonitor,
        tracker: TrackerControl,
        order: MeasurementOrder,
        start: tuple[float, ...],
    ) -> None:
        self.motion, self.settings = monitor.motion, monitor.settings
        self._monitor, self._tracker = monitor, tracker
        self._order, self._start = order, start
        self._progress = monitor.progress
        self._recorder, self._state = monitor.recorder, monitor.state
        self._commanded = order.commanded
        self._parts: queue.SimpleQueue[Commanded] = queue.SimpleQueue()
        self.is_concluding = False  # the rest is to be left out
        self._has_arrived = False  # at the end of the current line then
        self._target = ""  # that the tracker is to measure
        self._end: NDArray[np.float64] | None = None  # where the last motion ended

    @property
    def has_repeated(self) -> bool:
        """Whether lines were repeated."""
        return False

    @abstractmethod
    def run(self) -> None:
        """Measure, from the first approach to the end of the stream."""

    def _choose_target(self, name: str) -> None:
        if name in ("", self._target):
            return
        while not self._tracker.select_target(name):
            self.checkpoint()
        self._target = name

    def approach(self, position: NDArray[np.float64], target: str = "") -> None:
        """Move straight to a position and wait there.

        target : to be measured there; the tracker changes to it during the motion
        """
        self.checkpoint()
        begin, feed = self._monitor.position, self._order.feed_mm_min
        goal = Path(self.motion.axes, position[None], np.array([feed]), np.zeros(1))
        self._monitor.expect(goal)
        self.motion.move_to(tuple(map(float, position)), feed)
        self._choose_target(target)
        self.wait_motion(position, LastLine(0, np.array(begin), position))

    def open_stream(self) -> None:
        """Start the tracker's stream and record `lead_s` of it before any motion."""
        if not self._tracker.is_polled:
            self._tracker.begin_stream(self._order.rate_hz)
            self.record_for(self.settings.lead_s)

    def wait_motion(
        self,
        goal: NDArray[np.float64],
        last: LastLine | None = None,
        may_end: Callable[[MotionStatus], bool] = lambda _: False,
    ) -> None:
        """Wait until the machine is at rest at its goal.

        last : the line that ends there, if the machine moves by our order
        may_end : whether, at a status, the rest is to be omitted now

        Raises Fault if it stops elsewhere, or moves on from there.
        """
        grace_by_s = host_clock.now_s() + self.settings.confirm_s
        self._end, has_begun = goal, False
        while True:
            status = self._monitor.tick()
            if last is not None and status is not None:
                # At first a controller may show the last line of its program before.
                has_begun = has_begun or last.is_before(status)
                if has_begun and last.is_overrun(status):
                    raise make_runs_on_fault(self.motion.axes, status)
            if status is not None and may_end(status):
                self._end_motion()
                return
            if (
                status is None
                or status.state not in _STANDING
                or self._state.requires_standstill
            ):
                if status is not None and status.state is MotionState.RUNNING:
                    grace_by_s = host_clock.now_s() + 10 * self.settings.poll_s
                continue
            if self._monitor.is_at(goal):
                return
            if status.state is MotionState.ABORTED or host_clock.now_s() > grace_by_s:
                raise make_ended_early_fault(self.motion.axes, status, goal)

    def record_for(
        self, device_s: float, at: NDArray[np.float64] | None = None
    ) -> bool:
        """Wait at rest while the stream runs for this time on the tracker's clock.

        After a pause it starts over: earlier samples may lack the beam. True if the
        machine was at `at` all the time, where it is given.
        """
        begin_s = self._tracker.device_s
        while self._tracker.device_s - begin_s < device_s:
            self._monitor.tick()
            if self._state.requires_standstill:
                self.checkpoint()
                begin_s = self._tracker.device_s
            if at is not None and not self._monitor.is_at(at):
                row = self._progress.row + 1
                self._recorder.event("point", f"row {row}: moved while it was measured")
                return False
        return True

    def checkpoint(self) -> None:
        """Wait at rest for as long as a hold lasts."""
        self._monitor.tick()
        while self._state.requires_standstill:
            self._monitor.tick()

    def request_part(self) -> Commanded | None:
        """Wait at rest for a further part; check and record it.

        The part in the controller's axes, None if the measurement is concluded.
        """
        part = self._wait_for_part() if self._order.grows else None
        if part is None:
            return None
        return self._extend(part)

    def _extend(self, part: Commanded) -> Commanded:
        """The part in the controller's axes."""
        check_travel(self._order.machine, part)
        self._commanded = append_part(self._commanded, part)
        self._recorder.extend(self._commanded)
        schedule = schedule_rows(self._commanded, self._order.feed_mm_min)
        self._progress.extend(schedule)
        return arrange_axes(part, self.motion.axes, self._start)

    def _wait_for_part(self) -> Commanded | None:
        if not self.is_concluding and not self._tracker.is_polled:
            self.record_for(self.settings.settle_s)  # the data of the last row go first
        if not self.is_concluding:
            self._monitor.report(PartRequested(self._progress.row))
        while not self.is_concluding:
            self._tick_at_end()
            if not self._state.requires_standstill and not self._parts.empty():
                return self._parts.get_nowait()
        return None

    def finish(self) -> None:
        """Record `lead_s` after the last motion."""
        self._progress.end()
        begin_s = self._tracker.device_s
        while (
            not self._tracker.is_polled
            and self._tracker.device_s - begin_s < self.settings.lead_s
        ):
            self._tick_at_end()

    def _tick_at_end(self) -> None:
        """Raises Fault if the machine moves on."""
        status = self._monitor.tick()
        if status is None or self._end is None:
            return
        here = np.array(status.position)
        if self._state.requires_standstill:
            self._end = here  # an operator may move it by hand meanwhile
        elif (np.abs(here - self._end) > OVERSHOT).any():
            raise make_runs_on_fault(self.motion.axes, status)

    def miss_service(self) -> None:
        """Hold until an operator resumes: no pause or abort would have arrived."""
        if self._state.hold(HoldReason.SERVICE, str(SERVICE_SILENT)):
            self._monitor.events.report_fault(SERVICE_SILENT)
            self.motion.hold()

    def obey(self, command: MeasurementCommand) -> None:
        """Execute an operator's command, as `CellVerb` defines it."""
        match command:
            case CellVerb.PAUSE:
                if self._state.hold(HoldReason.OPERATOR, "pause"):
                    self.motion.hold()
            case CellVerb.RESUME if self._monitor.stream.is_good:
                self._state.release(*HoldReason, text="resume")
            case CellVerb.RESUME:
                self._monitor.events.report_fault(NO_BEAM)
            case CellVerb.CONCLUDE:
                self.is_concluding = True
            case Path() | Configurations():
                self._parts.put(command)
            case _:
                pass

    def exclude_rest(self, *, is_row_done: bool) -> None:
        """Record that the remaining rows are omitted.

        is_row_done : the current row is complete
        """
        self._progress.exclude_rest(is_row_done=is_row_done)
        text = f"row {self._progress.row + 1}: enough is known, the rest is left out"
        self._recorder.event("concluded", text)

    def _end_motion(self) -> None:
        self.exclude_rest(is_row_done=self._has_arrived)
        stand_by_s = host_clock.now_s() + self.settings.confirm_s
        while True:
            with contextlib.suppress(ConnectionLost, DeviceTimeout):
                self.motion.abort()
            status = self._monitor.tick()
            if status is not None and status.state in _STANDING:
                self._end = np.array(status.position)
                return
            if host_clock.now_s() > stand_by_s:
                raise UNSTOPPED


class PointSteps(MeasurementSteps):
    """The steps of a measurement at standstill.

    points : in the controller's axes
    """

    def __init__(
        self,
        monitor: MeasurementMonitor,
        tracker: TrackerControl,
        order: MeasurementOrder,
        start: tuple[float, ...],
        points: Configurations,
    ) -> None:
        super().__init__(monitor, tracker, order, start)
        self._points = points

    def run(self) -> None:
        """Measure at rest at every point in turn, then at further ones.

        The stream runs throughout; a polled tracker measures once the machine is at
        rest. Dwells are counted on the tracker's clock. A pause prolongs the
        standstill.
        """
        points = self._points
        self.approach(points.position[0], *points.target[:1])
        self.open_stream()
        part: Commanded | None = points
        while isinstance(part, Configurations):
            if not self._measure_each(part, is_at_first=part is points):
                break
            part = self.request_part()
        self.finish()

    def _measure_each(self, points: Configurations, *, is_at_first: bool) -> bool:
        """False if a point was omitted.

        is_at_first : the machine is at the first one already
        """
        for row, position in enumerate(points.position):
            self._progress.begin(self._progress.first_row + row)
            name = points.target[row] if points.target else ""
            if row > 0 or not is_at_first:
                self.approach(position, name)
            if self._tracker.is_polled:
                self._poll_point(position, float(points.dwell_s[row]), name)
            else:
                self._record_point(position, float(points.dwell_s[row]), name)
            until_s = f"until {self._tracker.device_s:.6f} s"
            self._recorder.event("point", f"row {self._progress.row + 1} {until_s}")
            if self.is_concluding and row + 1 < len(points):
                self.exclude_rest(is_row_done=True)
                return False
        return True

    def _record_point(
        self, position: NDArray[np.float64], dwell_s: float, name: str
    ) -> None:
        """Repeats until the machine was at rest throughout and the target is right."""
        span_s = self.settings.settle_s + dwell_s
        while not (
            self.record_for(span_s, position) and self._tracker.holds_target(name, None)
        ):
            self.checkpoint()
            self.wait_motion(position)

    def _poll_point(
        self, position: NDArray[np.float64], dwell_s: float, name: str
    ) -> None:
        """Repeats until the tracker has measured and the machine was at rest
        throughout.
        """
        is_measured = False
        while not is_measured:
            self.checkpoint()
            self.wait_motion(position)
            begin_s = host_clock.now_s()
            while host_clock.now_s() - begin_s < self.settings.settle_s:
                self._monitor.tick()
            is_measured = self._tracker.measure_point(self._progress.row, dwell_s, name)


def arrange_axes(
    commanded: Path | Configurations, axes: tuple[str, ...], here: tuple[float, ...]
) -> Path | Configurations:
    """Rows in the axis order of a controller.

    Axes that the plan does not name stay where they are. Raises Fault if the plan names
    an axis that the controller lacks.
    """
    missing = [name for name in commanded.axes if name not in axes]
    if missing:
        raise Fault(
            "wrong-device",
            f"the controller has axes {', '.join(axes)}, none is {missing[0]}",
            "check the machine file and the controller",
        )
    position: NDArray[np.float64] = np.tile(np.array(here, float), (len(commanded), 1))
    for column, name in enumerate(commanded.axes):
        position[:, axes.index(name)] = commanded.position[:, column]
    return replace(commanded, axes=axes, position=position)
