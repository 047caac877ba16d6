"""Has a lost target searched for while the machine stands, and goes on from there."""

from __future__ import annotations

from truepath.app.measurement.event_log import EventLog
from truepath.app.measurement.faults import make_unfound_fault
from truepath.app.measurement.feed_hold import FeedHold
from truepath.app.measurement.measurement_state import HoldReason, MeasurementState
from truepath.app.measurement.messages import CellState
from truepath.app.measurement.progress import ProgressEstimator
from truepath.app.measurement.rows_to_repeat import RowsToRepeat
from truepath.app.measurement.target_search import SearchStep, Sight, TargetSearch


class TargetRecovery:
    """What a measurement does about a lost target that its tracker can search.

    see : None of a tracker that is polled
    """

    def __init__(
        self,
        search: TargetSearch,
        see: Sight | None,
        progress: ProgressEstimator,
        feed: FeedHold,
        state: MeasurementState,
        rows: RowsToRepeat,
        events: EventLog,
    ) -> None:
        self._search, self._see, self._progress = search, see, progress
        self._feed, self._state, self._rows = feed, state, rows
        self._events = events

    def follow(self, position: dict[str, float], *, stands: bool) -> None:
        """Remember where the target is; have the tracker find one that is lost.

        position : of every axis, by name
        """
        name, point = self._progress.target, self._progress.point
        if HoldReason.BEAM not in self._state.holds:
            self._search.forget()
            self._rows.forget_loss()
            place_mm = None if self._see is None else self._see()
            if place_mm is not None:
                self._search.remember(position, name, place_mm, stands=stands)
        elif self._state.state is CellState.PAUSED:
            key = -1 if point is None else point
            step = self._search.advance(position, name, key, self._see)
            if step is not None:
                self._apply(step)

    def _apply(self, step: SearchStep) -> None:
        """Record a try; go on where it has found, and drive the lost line again."""
        self._events.record("found" if step.has_found else "search", step.text)
        if step.has_found:
            self._rows.repeat_loss()
            self._feed.release(HoldReason.BEAM, "the target was found again")
        elif step.is_last:
            self._events.report_fault(make_unfound_fault(step.text))
