"""The tracker's stream from the driver to the disk, and its assessment."""

from __future__ import annotations

import contextlib
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

import numpy as np

from truepath.errors import MeasurementFailed
from truepath.measurement.messages import TrackerTrial, TrackerTried
from truepath.measurement.monitors.plausibility import ObservedPoint
from truepath.measurement.run_file.recorder import Recorder
from truepath.measurement.time_limits import RunningClock, StreamTimeouts
from truepath_drivers import host_clock
from truepath_drivers.interfaces.errors import DeviceError, DeviceTimeout
from truepath_drivers.interfaces.records import TrackerSamples
from truepath_drivers.interfaces.tracker import AnyTracker, ByteLink, Tracker

BATCH_S = 0.1  # that is committed at once
READ_S = 0.02  # between reads of the tracker
TICK_S = 0.1


class StreamState(Enum):
    """Assessment of the stream."""

    GOOD = "good"
    SILENT = "silent"  # nothing came for a while: hold the feed
    DEAD = "dead"  # silent for so long that it will not recover
    DAMAGED = "damaged"  # too many samples are bad or lost: hold the feed
    BEAM_LOST = "beam-lost"  # samples come, none of them valid


OnStreamState = Callable[[int, int, StreamState], None]
"""Receives samples so far, samples lost and the stream's state, periodically."""


class StreamReader:
    """Reads blocks of some 20 ms and hands batches of some 100 ms to the recorder.

    It has a separate thread; any thread may call `assess` and read the properties.

    failure : error that ended the thread before it was stopped
    device_time_s : device clock of the newest sample, None before the first
    has_valid : a valid sample has come so far
    seen : the newest valid sample, with its counter of changes
    is_seen : that is the newest of all
    """

    def __init__(
        self,
        tracker: Tracker,
        recorder: Recorder,
        timeouts: StreamTimeouts,
    ) -> None:
        self._tracker, self._recorder, self._timeouts = tracker, recorder, timeouts
        # A process that did not run has not read either: that is no silence.
        self._clock = RunningClock(timeouts.late_s)
        self._lock = threading.Lock()
        self._damage: StreamDamage | None = None
        self._received_s = self._valid_s = self._clock()
        self._stopping = threading.Event()
        self._thread = threading.Thread(
            target=self._run, name="stream-reader", daemon=True
        )
        self.failure: Exception | None = None
        self.device_time_s: float | None = None
        self.has_valid = self.is_seen = False
        self.seen: ObservedPoint | None = None
        self._seen_s: float | None = None  # device time of the newest valid sample
        self._gap_s = 0.0

    def start(self, rate_hz: float) -> None:
        """Start the stream. Raises as `Tracker.start`."""
        drop_earlier_samples(self._tracker)
        self._take_link_bytes()
        self._damage = StreamDamage(rate_hz, self._timeouts.damaged_share)
        self._tracker.start(rate_hz)
        self._received_s = self._valid_s = self._clock()  # it took its time to start
        self._thread.start()

    def stop(self) -> None:
        """Hand over pending samples, then end the stream. Idempotent."""
        self._stopping.set()
        if self._thread.ident is not None:
            host_clock.join(self._thread)
        self._tracker.stop()

    def assess(self) -> StreamState:
        """State at this moment, from times and losses."""
        now_s = self._clock()
        with self._lock:
            silence_s = now_s - self._received_s
            # A beam is assessed by the samples that came, not by their absence.
            without_beam_s = self._received_s - self._valid_s
            is_damaged = self._damage is not None and self._damage.is_over_limit
        if silence_s > self._timeouts.dead_s:
            return StreamState.DEAD
        if silence_s > self._timeouts.silent_s:
            return StreamState.SILENT
        if is_damaged:
            return StreamState.DAMAGED
        if without_beam_s > self._timeouts.beam_s:
            return StreamState.BEAM_LOST
        return StreamState.GOOD

    def pop_gap_s(self) -> float:
        """Longest gap between valid samples since the last call, tracker's clock.

        A gap counts once a valid sample has ended it.
        """
        with self._lock:
            gap_s, self._gap_s = self._gap_s, 0.0
        return gap_s

    def _run(self) -> None:
        try:
            while not self._stopping.is_set():
                self._fill_batch()
            self._hand_over([self._tracker.read(0.0)])
        except Exception as error:
            self.failure = error

    def _fill_batch(self) -> None:
        blocks: list[TrackerSamples] = []
        end_s = host_clock.now_s() + BATCH_S
        while (
            left_s := end_s - host_clock.now_s()
        ) > 0 and not self._stopping.is_set():
            block = self._tracker.read(left_s)
            if not (timed := np.isfinite(block.device_time_s)).all():
                block = block.select(timed)  # its place in the stream is not known
            self._note_arrival(block)
            blocks.append(block)
            host_clock.wait(self._stopping, READ_S)
        self._hand_over(blocks)

    def _note_arrival(self, block: TrackerSamples) -> None:
        now_s = self._clock()
        if not len(block):
            return
        crc_errors = self._tracker.health.crc_errors
        with self._lock:
            self._received_s = now_s
            if self._damage is not None:
                self._damage.note(block, crc_errors)
            self.device_time_s = float(block.device_time_s[-1])
            valid = np.flatnonzero(block.status == 0)
            self.is_seen = bool(block.status[-1] == 0)
            if len(valid):
                self._valid_s, self.has_valid = now_s, True
                changes = 0
                if self.seen is not None:
                    same = block.position_mm[valid] == self.seen.place_mm
                    changes = self.seen.changes + (not same.all())
                newest = block.position_mm[valid[-1]]
                self.seen = ObservedPoint(self.device_time_s, newest, changes)
                valid_s = block.device_time_s[valid]
                before_s = valid_s[0] if self._seen_s is None else self._seen_s
                longest_s = float(np.diff(valid_s, prepend=before_s).max())
                self._gap_s = max(self._gap_s, longest_s)
                self._seen_s = float(valid_s[-1])

    def _hand_over(self, blocks: list[TrackerSamples]) -> None:
        self._recorder.put_tracker(TrackerSamples.join(blocks), self._take_link_bytes())

    def _take_link_bytes(self) -> bytes:
        tracker = self._tracker
        return tracker.take_link_bytes() if isinstance(tracker, ByteLink) else b""


def record_stream(
    tracker: Tracker,
    recorder: Recorder,
    rate_hz: float,
    is_over: Callable[[float], bool],
    on_state: OnStreamState,
) -> None:
    """Record a connected tracker while a CNC without link executes its program.

    Nothing is known of the CNC meanwhile: the times of its lines are found in the
    stream afterwards. The caller closes the recorder.

    is_over : waits at most this many seconds; true ends the recording

    Raises DeviceTimeout if the stream is dead, MeasurementFailed if the disk fails,
    DeviceError of the driver; data recorded by then are kept.
    """
    reader = StreamReader(tracker, recorder, StreamTimeouts())
    reader.start(rate_hz)
    try:
        while not is_over(TICK_S):
            _reject_failures(reader, recorder)
            state = reader.assess()
            on_state(recorder.samples, recorder.lost_samples, state)
            if state is StreamState.DEAD:
                raise DeviceTimeout(
                    "no sample has come for some seconds; check the tracker and its "
                    "cable, then run the program again"
                )
    except BaseException:
        # A lost tracker cannot be stopped: the first error counts.
        with contextlib.suppress(DeviceError):
            reader.stop()
        raise
    reader.stop()
    _reject_failures(reader, recorder)


def _reject_failures(reader: StreamReader, recorder: Recorder) -> None:
    if reader.failure is not None:
        raise reader.failure
    if recorder.failure:
        raise MeasurementFailed(recorder.failure)
    if recorder.is_space_low:
        raise MeasurementFailed("too little room is left on the disk; free some")


_WINDOW_S = 1.0


@dataclass(frozen=True, slots=True)
class _Losses:
    device_time_s: float
    lost: int
    gaps: int
    crc_errors: int


class StreamDamage:
    """Counts bad or lost samples in the last second of the tracker's clock.

    A single gap is a silence, however long, and not counted here.

    share : limit, as a fraction of the samples
    """

    def __init__(self, rate_hz: float, share: float) -> None:
        self._limit = max(share * rate_hz * _WINDOW_S, 1.0)
        self._recent: deque[_Losses] = deque()
        self._sequence: int | None = None
        self._crc_errors: int | None = None

    def note(self, samples: TrackerSamples, crc_errors: int) -> None:
        """Add a block that is not empty; crc_errors is the total so far."""
        first = int(samples.sequence[0])
        before = first - 1 if self._sequence is None else self._sequence
        missing = np.diff(samples.sequence, prepend=before) - 1
        bad = 0 if self._crc_errors is None else crc_errors - self._crc_errors
        self._sequence, self._crc_errors = int(samples.sequence[-1]), crc_errors
        now_s = float(samples.device_time_s[-1])
        lost, gaps = int(missing.sum()), int((missing > 0).sum())
        self._recent.append(_Losses(now_s, lost, gaps, bad))
        while self._recent[0].device_time_s <= now_s - _WINDOW_S:
            self._recent.popleft()

    @property
    def is_over_limit(self) -> bool:
        """Whether more than the allowed share of a second is bad or lost."""
        lost = sum(losses.lost for losses in self._recent)
        gaps = sum(losses.gaps for losses in self._recent)
        bad = sum(losses.crc_errors for losses in self._recent)
        return max(lost if gaps > 1 else 0, bad) > self._limit


_READ_S = 0.2
_FIRST_S = 2.0  # in which an instrument that has just been started sends
_LEAST_TIMED = 20  # samples, for a rate


def try_tracker(tracker: AnyTracker, trial: TrackerTrial) -> TrackerTried:
    """Statistics of the samples of a connected tracker. Raises DeviceError."""
    if not isinstance(tracker, Tracker):
        if trial.streams_only:
            return TrackerTried(0, 0, 0, None, streams=False)
        point = tracker.measure(trial.duration_s)
        distance_mm = float(np.linalg.norm(point.position_mm))
        return TrackerTried(point.count, point.count, 0, distance_mm)
    drop_earlier_samples(tracker)
    blocks: list[TrackerSamples] = []
    tracker.start(trial.rate_hz)
    try:
        end_s = host_clock.now_s() + _FIRST_S
        while host_clock.now_s() < end_s:
            block = tracker.read(_READ_S)
            if len(block) and not blocks:
                end_s = host_clock.now_s() + trial.duration_s
            if len(block):
                blocks.append(block)
    finally:
        tracker.stop()
    read = TrackerSamples.join(blocks)
    found_mm = np.linalg.norm(read.position_mm[read.status == 0], axis=1)
    mean_mm = float(found_mm.mean()) if len(found_mm) else None
    return TrackerTried(
        len(read), len(found_mm), read.lost, mean_mm, _compute_rate_hz(read)
    )


def drop_earlier_samples(tracker: Tracker) -> None:
    """Discard samples of an earlier stream: they are not current."""
    while len(tracker.read(0.0)):
        pass


def _compute_rate_hz(read: TrackerSamples) -> float | None:
    """Includes lost samples; None where there are too few."""
    if len(read) < _LEAST_TIMED:
        return None
    span_s = float(read.device_time_s[-1] - read.device_time_s[0])
    count = len(read) + read.lost - 1
    return count / span_s if span_s > 0.0 and count > 0 else None
