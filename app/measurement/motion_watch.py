"""The controller as the engine sees it: watched, fed with beats, noted down."""

from __future__ import annotations

import contextlib
from collections.abc import Callable

import numpy as np

from app.errors import MeasurementFailed
from app.measurement.faults import fault_of
from app.measurement.limits import Limits
from app.measurement.recorder import Recorder
from drivers.interfaces.errors import ConnectionLost, DeviceTimeout
from drivers.interfaces.motion import MotionController
from drivers.interfaces.records import AxisSamples, MotionStatus


class MotionWatch:
    """Reads a controller that may be out of reach for a moment.

    position : where the axes were when last seen
    """

    def __init__(
        self,
        motion: MotionController,
        recorder: Recorder,
        limits: Limits,
        clock: Callable[[], float],
    ) -> None:
        self._motion, self._recorder = motion, recorder
        self._limits, self._clock = limits, clock
        self._unreached_s: float | None = None
        self._rows: list[tuple[float, ...]] = []
        self.position: tuple[float, ...] = ()

    def look(self) -> MotionStatus | None:
        """Feed the watchdog and read the controller; None if it did not answer.

        Raises Fault once it has been out of reach for too long.
        """
        try:
            self._motion.beat()
            status = self._motion.status()
        except (ConnectionLost, DeviceTimeout) as error:
            now_s = self._clock()
            self._unreached_s = self._unreached_s or now_s
            if now_s - self._unreached_s > self._limits.link_s:
                raise fault_of(error) from error
            return None
        self._unreached_s = None
        self.position = status.position
        self._rows.append((self._clock(), *status.position))
        if len(self._rows) >= self._limits.axes_rows:
            self._write()
        return status

    def command(self, verb: Callable[[], None]) -> None:
        """Tell the controller. Out of reach is for `look` to notice; ask again then."""
        with contextlib.suppress(ConnectionLost, DeviceTimeout):
            verb()

    def flush(self) -> None:
        """Write the positions that wait. Never raises."""
        with contextlib.suppress(MeasurementFailed):
            self._write()

    def _write(self) -> None:
        if self._rows:
            rows = np.array(self._rows)
            self._rows = []
            axes = self._motion.axes
            self._recorder.put_axes(AxisSamples(axes, rows[:, 0], rows[:, 1:]))
