"""The steps of standstill points: approach, stand, record or have it measured."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from truepath.app.measurement.measurement_monitor import MeasurementMonitor
from truepath.app.measurement.measurement_steps import MeasurementSteps
from truepath.app.measurement.messages import MeasurementOrder
from truepath.app.measurement.tracker_control import TrackerControl
from truepath.app.motion.configurations import Commanded, Configurations


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
        """Stand at every point in turn while the stream runs, then at further ones.

        A tracker that is polled measures once the machine stands; there is no stream.
        Dwells are counted on the tracker's clock. A pause prolongs the standstill.
        """
        points = self._points
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
            if self._tracker.is_polled:
                self._poll_point(position, float(points.dwell_s[row]), name)
            else:
                self._record_point(position, float(points.dwell_s[row]), name)
            until_s = f"until {self._tracker.device_s:.6f} s"
            self._recorder.event("point", f"row {self._progress.row + 1} {until_s}")
            if self.is_concluding and row + 1 < len(points):
                self.leave_out_rest(is_row_done=True)
                return False
        return True

    def _record_point(
        self, position: NDArray[np.float64], dwell_s: float, name: str
    ) -> None:
        """Stand while the stream runs, until it has been there, of the right target."""
        span_s = self.settings.settle_s + dwell_s
        while not (
            self.record_for(span_s, position) and self._tracker.holds_target(name, None)
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
            is_measured = self._tracker.measure_point(self._progress.row, dwell_s, name)
