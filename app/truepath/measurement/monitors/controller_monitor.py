"""Reading of the controller during a measurement, and its watchdog."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from truepath.errors import MeasurementFailed
from truepath.measurement.faults import (
    Fault,
    classify_fault,
    make_late_fault,
    make_position_fault,
)
from truepath.measurement.monitors.plausibility import PositionGate
from truepath.measurement.run_file.recorder import Recorder
from truepath.measurement.time_limits import EngineSettings, Stopwatch
from truepath_drivers import host_clock
from truepath_drivers.interfaces.errors import ConnectionLost, DeviceTimeout
from truepath_drivers.interfaces.motion import MotionController
from truepath_drivers.interfaces.records import AxisSamples, MotionStatus


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
