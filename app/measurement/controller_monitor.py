"""Reads the controller while a measurement waits, and feeds its watchdog."""

from __future__ import annotations

import contextlib
from collections.abc import Callable

import numpy as np

from truepath.app.errors import MeasurementFailed
from truepath.app.measurement.faults import Fault, classify_fault, make_late_fault
from truepath.app.measurement.recorder import Recorder
from truepath.app.measurement.timing import EngineSettings, Stopwatch
from truepath.drivers.interfaces.errors import ConnectionLost, DeviceTimeout
from truepath.drivers.interfaces.motion import MotionController
from truepath.drivers.interfaces.records import AxisSamples, MotionStatus


class ControllerMonitor:
    """Reads a controller that may be out of reach for a moment.

    position : where the axes were at the last reading
    late : why the last valid status is too old, None where it is not
    """

    def __init__(
        self,
        motion: MotionController,
        recorder: Recorder,
        settings: EngineSettings,
    ) -> None:
        self._motion, self._recorder, self._settings = motion, recorder, settings
        self._out_of_reach = Stopwatch(settings.clock)
        self._rows: list[tuple[float, ...]] = []
        self._valid_s = settings.clock()
        self.position: tuple[float, ...] = ()
        self.late: Fault | None = None

    def poll(self) -> MotionStatus | None:
        """Read the controller, then feed its watchdog; None if it did not answer.

        Requests may arrive whose replies do not: who is not seen is not fed. Raises
        Fault once it has been out of reach for too long.
        """
        try:
            status = self._motion.status()
            self._valid_s, self.late = self._settings.clock(), None
            self._motion.send_heartbeat()
        except (ConnectionLost, DeviceTimeout) as error:
            if self._out_of_reach.measure_s() > self._settings.link_s:
                raise classify_fault(error) from error
            if self._settings.clock() - self._valid_s > self._settings.stale_s:
                self.late = make_late_fault(error)
            return None
        self._out_of_reach.reset()
        self.position = status.position
        self._rows.append((self._settings.clock(), *status.position))
        if len(self._rows) >= self._settings.axes_rows:
            self._write()
        return status

    def command(self, verb: Callable[[], None]) -> None:
        """Send a command. If the controller is out of reach, `poll` notices it."""
        with contextlib.suppress(ConnectionLost, DeviceTimeout):
            verb()

    def flush(self) -> None:
        """Record the positions that wait. Never raises."""
        with contextlib.suppress(MeasurementFailed):
            self._write()

    def _write(self) -> None:
        if self._rows:
            rows = np.array(self._rows)
            self._rows = []
            axes = self._motion.axes
            self._recorder.put_axes(AxisSamples(axes, rows[:, 0], rows[:, 1:]))
