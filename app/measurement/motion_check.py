"""Whether a machine that says it runs does move."""

from __future__ import annotations

from truepath.app.measurement.event_log import EventLog
from truepath.app.measurement.faults import STALLED, UNMOVED
from truepath.app.measurement.timing import EngineSettings, Stopwatch
from truepath.drivers.interfaces.records import MotionState, MotionStatus


class MotionCheck:
    """Compares the positions of a machine that runs from look to look."""

    def __init__(self, events: EventLog, settings: EngineSettings) -> None:
        self._events, self._settings = events, settings
        self._unmoved = Stopwatch(settings.clock)
        self._here: tuple[float, ...] = ()
        self._is_reported = False

    def follow(self, status: MotionStatus, longest_row_s: float) -> None:
        """Report once of a machine that says it runs, and moves no further.

        longest_row_s : planned, the time for which a machine may dwell
        """
        is_stuck = status.state is MotionState.RUNNING and status.position == self._here
        self._here = status.position
        if not is_stuck:
            self._unmoved.reset()
            self._is_reported = False
            return
        stalled = status.override == 0.0
        # A machine that dwells does not move either; one at 0 % does not dwell.
        patience_s = 0.0 if stalled else longest_row_s
        late = self._unmoved.measure_s() > self._settings.stuck_s + patience_s
        if late and not self._is_reported:
            self._is_reported = True
            self._events.report_fault(STALLED if stalled else UNMOVED)
