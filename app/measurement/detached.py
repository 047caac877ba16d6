"""Records the tracker while a CNC without any link drives a program loaded by hand.

Nothing is known of the CNC while it moves: no position, no state, no way to hold it.
What was driven when is found in the stream afterwards.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable

from app.errors import MeasurementFailed
from app.measurement.engine_settings import StreamTimeouts
from app.measurement.recorder import Recorder
from app.measurement.stream_monitor import StreamMonitor, StreamState
from app.measurement.stream_reader import StreamReader
from drivers.interfaces.errors import DeviceError, DeviceTimeout
from drivers.interfaces.tracker import Tracker

TICK_S = 0.1

OnStreamState = Callable[[int, int, StreamState], None]
"""Receives samples so far, samples lost and the stream's state, again and again."""


def record_stream(
    tracker: Tracker,
    recorder: Recorder,
    rate_hz: float,
    is_over: Callable[[float], bool],
    on_state: OnStreamState,
) -> None:
    """Record a connected tracker until it is over; the caller closes the recorder.

    is_over : waits at most so many seconds and tells whether the recording is to end

    Raises DeviceTimeout if the stream is dead, MeasurementFailed if the disk fails,
    DeviceError of the driver; what has been recorded by then is kept.
    """
    monitor = StreamMonitor(StreamTimeouts(), time.monotonic())
    reader = StreamReader(tracker, recorder, monitor)
    reader.start(rate_hz)
    try:
        while not is_over(TICK_S):
            _refuse_failures(reader, recorder)
            state = monitor.assess(time.monotonic())
            on_state(recorder.samples, recorder.lost_samples, state)
            if state is StreamState.DEAD:
                raise DeviceTimeout(
                    "no sample has come for some seconds; check the tracker and its "
                    "cable, then run the program again"
                )
    except BaseException:
        # A tracker that is gone cannot be told to stop: what went wrong first counts.
        with contextlib.suppress(DeviceError):
            reader.stop()
        raise
    reader.stop()
    _refuse_failures(reader, recorder)


def _refuse_failures(reader: StreamReader, recorder: Recorder) -> None:
    if reader.failure is not None:
        raise reader.failure
    if recorder.failure:
        raise MeasurementFailed(recorder.failure)
    if recorder.is_space_low:
        raise MeasurementFailed("too little room is left on the disk; free some")
