"""Records the tracker while a CNC without any link drives a program loaded by hand.

Nothing is known of the CNC while it moves: no position, no state, no way to hold it.
What was driven when is found in the stream afterwards.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable

from app.errors import MeasurementFailed
from app.measurement.limits import Patience
from app.measurement.pump import Pump
from app.measurement.recorder import Recorder
from app.measurement.stream_watch import StreamWatch, Verdict
from drivers.interfaces.errors import DeviceError, DeviceTimeout
from drivers.interfaces.tracker import Tracker

TICK_S = 0.1

Told = Callable[[int, int, Verdict], None]
"""Samples so far, samples lost, and how the stream is; several times a second."""


def record_stream(
    tracker: Tracker,
    recorder: Recorder,
    rate_hz: float,
    is_over: Callable[[float], bool],
    told: Told,
) -> None:
    """Record a connected tracker until it is over; the caller closes the recorder.

    is_over : waits at most so many seconds and tells whether the recording is to end

    Raises DeviceTimeout if the stream is dead, MeasurementFailed if the disk fails,
    DeviceError of the driver; what has been recorded by then is kept.
    """
    watch = StreamWatch(Patience(), time.monotonic())
    pump = Pump(tracker, recorder, watch)
    pump.start(rate_hz)
    try:
        while not is_over(TICK_S):
            _refuse_failures(pump, recorder)
            verdict = watch.verdict(time.monotonic())
            told(recorder.samples, recorder.lost_samples, verdict)
            if verdict is Verdict.DEAD:
                raise DeviceTimeout(
                    "no sample has come for some seconds; check the tracker and its "
                    "cable, then run the program again"
                )
    except BaseException:
        # A tracker that is gone cannot be told to stop: what went wrong first counts.
        with contextlib.suppress(DeviceError):
            pump.stop()
        raise
    pump.stop()
    _refuse_failures(pump, recorder)


def _refuse_failures(pump: Pump, recorder: Recorder) -> None:
    if pump.failure is not None:
        raise pump.failure
    if recorder.failure:
        raise MeasurementFailed(recorder.failure)
    if recorder.low_space:
        raise MeasurementFailed("too little room is left on the disk; free some")
