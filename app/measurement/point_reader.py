"""Measures one standstill point with a tracker that is polled, in a thread of its own.

A measurement lasts as long as the instrument takes; meanwhile the engine goes on
feeding the controller's watchdog.
"""

from __future__ import annotations

import threading

from truepath.drivers.interfaces.errors import BeamLost
from truepath.drivers.interfaces.records import is_seen
from truepath.drivers.interfaces.tracker import ByteLink, PolledTracker
from truepath.drivers.interfaces.tracker_records import PointMeasurement

JOIN_S = 5.0


class PointReader:
    """One point under way. Begins at once; any thread may look at it.

    failure : why there is no point
    """

    def __init__(self, tracker: PolledTracker, dwell_s: float) -> None:
        self._tracker, self._dwell_s = tracker, dwell_s
        self._point: PointMeasurement | None = None
        self.failure: Exception | None = None
        self._thread = threading.Thread(target=self._run, name="point", daemon=True)
        self._thread.start()

    @property
    def is_over(self) -> bool:
        """Whether there is a point or a failure."""
        return not self._thread.is_alive()

    @property
    def point(self) -> PointMeasurement:
        """The point, once it is over without a failure."""
        if self._point is None:
            raise RuntimeError("the point is not measured yet")
        return self._point

    def stop(self) -> None:
        """End the measurement and wait for its thread."""
        self._tracker.stop()
        self._thread.join(JOIN_S)

    def take_link_bytes(self) -> bytes:
        """Return the bytes that carried the point."""
        tracker = self._tracker
        return tracker.take_link_bytes() if isinstance(tracker, ByteLink) else b""

    def _run(self) -> None:
        """Body of the thread."""
        try:
            point = self._tracker.measure(self._dwell_s)
            if not is_seen(point.position_mm).all():
                raise BeamLost("the tracker shows a place that no beam reaches")
            self._point = point
        except Exception as error:
            self.failure = error
