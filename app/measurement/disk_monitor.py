"""Holds the feed while the disk cannot keep up with what is recorded."""

from __future__ import annotations

from truepath.app.measurement.faults import DISK_STAYS_SLOW, SLOW_DISK, Fault
from truepath.app.measurement.feed_hold import FeedHold
from truepath.app.measurement.measurement_state import HoldReason, MeasurementState
from truepath.app.measurement.recorder import Recorder
from truepath.app.measurement.timing import EngineSettings, Stopwatch

BY_ITSELF_S = 10.0
"""By then somebody may have walked up to the machine: it waits for a person."""


class DiskMonitor:
    """The disk of one measurement. Belongs to the thread of the engine."""

    def __init__(
        self,
        feed: FeedHold,
        state: MeasurementState,
        recorder: Recorder,
        settings: EngineSettings,
    ) -> None:
        self._feed, self._state, self._recorder = feed, state, recorder
        self._held = Stopwatch(settings.clock)

    def check(self) -> None:
        """Hold the feed while too much waits. Raises Fault if the disk fails."""
        recorder = self._recorder
        if recorder.failure or recorder.is_space_low:
            text = recorder.failure or "the disk is almost full"
            action = "free some space, then measure again"
            raise Fault("storage", text, action, latched=False)
        if recorder.is_strained:
            self._feed.hold(HoldReason.DISK, SLOW_DISK)
        self._follow_hold()
        if recorder.is_relaxed and HoldReason.DISK in self._state.holds:
            self._feed.release(HoldReason.DISK, "the disk has caught up")

    def _follow_hold(self) -> None:
        """Leave it to a person to go on where the disk was slow for too long."""
        if HoldReason.DISK not in self._state.holds:
            self._held.reset()
        elif self._held.measure_s() > BY_ITSELF_S:
            self._feed.hold(HoldReason.DISK_STAYED_SLOW, DISK_STAYS_SLOW)
