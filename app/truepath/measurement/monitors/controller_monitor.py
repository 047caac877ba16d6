"""The controller during a measurement: its watchdog, readings, holds of the feed.

Every hold has a reason (`measurement_state`); the machine moves while there is none. A
controller that does not follow in time is a fault.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from truepath.errors import MeasurementFailed
from truepath.measurement.faults import (
    STILL_HELD,
    Fault,
    classify_fault,
    make_held_fault,
    make_late_fault,
    make_position_fault,
)
from truepath.measurement.measurement_state import HoldReason, MeasurementState
from truepath.measurement.messages import CellState
from truepath.measurement.monitors.plausibility import PositionGate
from truepath.measurement.run_file.recorder import EventLog, Recorder
from truepath.measurement.time_limits import EngineSettings, Stopwatch
from truepath_drivers import host_clock
from truepath_drivers.interfaces.errors import ConnectionLost, DeviceTimeout
from truepath_drivers.interfaces.motion import MotionController
from truepath_drivers.interfaces.records import AxisSamples, MotionState, MotionStatus


class ControllerMonitor:
    """A controller that may be out of reach for a moment.

    tracker_s : the tracker's clock
    position : axes at the last plausible reading
    doubt : why the last one is implausible, else empty; doubts : number in a row
    late : why the last valid status is too old, else None
    """

    def __init__(
        self,
        motion: MotionController,
        recorder: Recorder,
        settings: EngineSettings,
        tracker_s: Callable[[], float | None] = lambda: None,
    ) -> None:
        self.gate = PositionGate(motion, tracker_s)
        self.doubt, self.doubts = "", 0
        self._motion, self._recorder, self._settings = motion, recorder, settings
        self._out_of_reach = Stopwatch()
        self._rows: list[tuple[float, ...]] = []
        self._valid_s = host_clock.now_s()
        self.position: tuple[float, ...] = ()
        self.late: Fault | None = None

    def poll(self) -> MotionStatus | None:
        """Read the controller, then feed its watchdog; None if it did not answer.

        Requests may arrive whose replies do not: a controller that is not read is not
        fed. Raises Fault once it has been out of reach for too long. A status whose
        position is implausible carries the last plausible one.
        """
        asked_s = host_clock.now_s()
        try:
            status = self._motion.status()
            self._valid_s, self.late = host_clock.now_s(), None
            self._motion.send_heartbeat()
        except (ConnectionLost, DeviceTimeout) as error:
            if self._out_of_reach.measure_s() > self._settings.link_s:
                raise classify_fault(error) from error
            if host_clock.now_s() - self._valid_s > self._settings.stale_s:
                self.late = make_late_fault(error)
            return None
        self._out_of_reach.reset()
        now_s = host_clock.now_s()
        self.doubt = self.gate.check(status, asked_s, now_s)
        if self.doubt:
            if not self.position:
                raise make_position_fault(self.doubt)
            self.doubts += 1
            return replace(status, position=self.position)
        self.position, self.doubts = status.position, 0
        self._rows.append((now_s, *status.position))
        if len(self._rows) >= self._settings.axes_rows:
            self._write()
        return status

    def command(self, verb: Callable[[], None]) -> None:
        """Send a command. If the controller is out of reach, `poll` notices it."""
        with contextlib.suppress(ConnectionLost, DeviceTimeout):
            verb()

    def flush(self) -> None:
        """Record pending positions. Never raises."""
        with contextlib.suppress(MeasurementFailed):
            self._write()

    def _write(self) -> None:
        if self._rows:
            rows = np.array(self._rows)
            self._rows = []
            axes = self._motion.axes
            self._recorder.put_axes(AxisSamples(axes, rows[:, 0], rows[:, 1:]))


_EVENTS = {HoldReason.DISK: "storage", HoldReason.CONTROL: "control"}


class FeedHold:
    """The feed of one measurement: held for reasons, released when none remains."""

    def __init__(
        self,
        motion: MotionController,
        machine: ControllerMonitor,
        state: MeasurementState,
        events: EventLog,
        settings: EngineSettings,
    ) -> None:
        self._motion, self._machine = motion, machine
        self._state, self._events, self._settings = state, events, settings
        self._is_machine_hold_reported = False
        self._late: Fault | None = None  # what the last silence of the control was
        self._unconfirmed_hold = Stopwatch()
        self._unconfirmed_resume = Stopwatch()

    def hold(self, reason: HoldReason, fault: Fault) -> None:
        """Hold the feed and report it, unless it is held for this reason already."""
        if self._state.hold(reason, fault.text):
            self._events.report_fault(fault)
            self._machine.command(self._motion.hold)

    def hold_blindly(self) -> None:
        """Send a hold to a controller that does not answer; to be called repeatedly."""
        if (late := self._machine.late) is not None:
            self._late = late
            self.hold(HoldReason.CONTROL, late)
            self._machine.command(self._motion.hold)

    def release(self, reason: HoldReason, text: str) -> None:
        """Withdraw a reason to hold; others may remain."""
        self._events.record(_EVENTS.get(reason, "stream"), text)
        self._is_machine_hold_reported = False  # it may be the only reason left
        self._state.release(reason, text=text)

    def follow(self, status: MotionStatus) -> None:
        """Repeat unconfirmed commands; report a hold of the machine itself.

        The state has observed this status. Raises Fault if the machine moves on.
        """
        if HoldReason.CONTROL in self._state.holds:
            self.release(HoldReason.CONTROL, "the controller answers again")
        elif not self._state.holds:
            self._late = None
        self._report_machine_hold(status.hold_reason)
        if self._state.wants_hold and status.state is MotionState.RUNNING:
            self._insist_on_hold()
        else:
            self._unconfirmed_hold.reset()
        self._insist_on_resume(status)

    def _report_machine_hold(self, hold_reason: str) -> None:
        waits = HoldReason.MACHINE in self._state.holds
        if waits and not self._is_machine_hold_reported:
            late = self._late if hold_reason == "watchdog" else None
            self._events.report_fault(make_held_fault(hold_reason, late))
        self._is_machine_hold_reported = waits

    def _insist_on_hold(self) -> None:
        self._machine.command(self._motion.hold)
        if self._unconfirmed_hold.measure_s() > self._settings.confirm_s:
            raise Fault(
                "hold-unconfirmed",
                f"the machine moves {self._settings.confirm_s:g} s after a hold",
                "press feed hold at the machine",
                latched=True,
            )

    def _insist_on_resume(self, status: MotionStatus) -> None:
        if self._state.state is not CellState.RESUMING:
            self._unconfirmed_resume.reset()
            return
        self._machine.command(self._motion.resume)
        if self._unconfirmed_resume.measure_s() > self._settings.confirm_s:
            self._events.report_fault(STILL_HELD)
            self._state.fall_back(f"still held: {status.hold_reason}")
            self._is_machine_hold_reported = True
