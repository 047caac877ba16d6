"""Assesses the stream at every look, and holds the feed while it is not good."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from truepath.app.measurement.event_log import EventLog
from truepath.app.measurement.faults import (
    BEAM_LOST,
    DAMAGED,
    SILENT,
    STAYS_DAMAGED,
    classify_fault,
    make_silence_fault,
)
from truepath.app.measurement.feed_hold import FeedHold
from truepath.app.measurement.measurement_state import HoldReason, MeasurementState
from truepath.app.measurement.plausibility import SeenPlace
from truepath.app.measurement.rows_to_repeat import RowsToRepeat
from truepath.app.measurement.stream_reader import StreamReader, StreamState
from truepath.app.measurement.timing import EngineSettings, Stopwatch
from truepath.drivers.interfaces.errors import DeviceError

# Without a valid sample. Figures of a circle need some in every 3°: on one of 230 mm
# these take 0.12 s at 3000 mm/min.
_BREAK_S = 0.1


class StreamMonitor:
    """The stream of one measurement, once it is opened.

    `is_good` is for any thread; everything else belongs to the thread of the engine.
    """

    def __init__(
        self,
        feed: FeedHold,
        state: MeasurementState,
        events: EventLog,
        rows: RowsToRepeat,
        settings: EngineSettings,
    ) -> None:
        self._feed, self._state, self._events = feed, state, events
        self._rows, self._timeouts = rows, settings.timeouts
        self._stream: StreamReader | None = None
        self._damaged = Stopwatch(settings.clock)

    def watch(self, stream: StreamReader) -> None:
        """Assess this stream from now on."""
        self._stream = stream

    def end(self) -> None:
        """End the stream and record what waits. Idempotent, never raises."""
        if self._stream is not None:
            try:
                self._stream.stop()
            except DeviceError as error:
                self._events.record("tracker", str(error))

    @property
    def is_good(self) -> bool:
        """Whether a stream under way brings valid samples; true where there is none."""
        return self._stream is None or self._stream.assess() is StreamState.GOOD

    @property
    def device_time_s(self) -> float | None:
        """The tracker's clock at its newest sample, None before the first."""
        return None if self._stream is None else self._stream.device_time_s

    @property
    def place_mm(self) -> NDArray[np.float64] | None:
        """Where the target was in the newest valid sample, None before the first."""
        return None if self._stream is None else self._stream.place_mm

    def see(self) -> NDArray[np.float64] | None:
        """Return where the stream has the target now, None while it is not seen."""
        stream = self._stream
        if stream is None or stream.assess() is not StreamState.GOOD:
            return None
        return stream.place_mm if stream.is_seen else None

    def find_seen(self) -> SeenPlace | None:
        """Return where it had the target last, None where the stream is not good."""
        return self._stream.seen if self._stream is not None and self.is_good else None

    def check(self, *, may_lose_beam: bool) -> None:
        """Hold the feed while the stream is not good. Raises Fault if it stays so.

        may_lose_beam : the tracker goes from one target to another
        """
        if self._stream is None:
            return
        if self._stream.failure is not None:
            raise classify_fault(self._stream.failure)
        state = self._stream.assess()
        if state is StreamState.DEAD:
            raise make_silence_fault(self._timeouts.dead_s)
        if state is StreamState.SILENT:
            self._feed.hold(HoldReason.SILENCE, SILENT)
        elif state is StreamState.BEAM_LOST and not may_lose_beam:
            self._feed.hold(HoldReason.BEAM, BEAM_LOST)
            self._rows.note_loss()
        elif state is StreamState.GOOD:
            # Too short for anybody to have walked up to the machine: go on by itself.
            for reason in {HoldReason.SILENCE, HoldReason.DAMAGE} & self._state.holds:
                self._feed.release(reason, "the stream is good again")
        lacks_samples = self._stream.take_gap_s() > _BREAK_S
        self._rows.follow(is_broken=lacks_samples or self._state.must_stand)
        self._follow_damage(is_damaged=state is StreamState.DAMAGED)

    def _follow_damage(self, *, is_damaged: bool) -> None:
        """Hold while the stream is damaged; keep the row that it began in."""
        if not is_damaged:
            self._damaged.reset()
            return
        self._feed.hold(HoldReason.DAMAGE, DAMAGED)
        self._rows.note_damage()
        if self._damaged.measure_s() > self._timeouts.damaged_s:
            raise STAYS_DAMAGED
