"""Short trial of the tracker's stream. Nothing moves."""

from __future__ import annotations

import numpy as np

from truepath.measurement.messages import TrackerTrial, TrackerTried
from truepath_drivers import host_clock
from truepath_drivers.interfaces.records import TrackerSamples
from truepath_drivers.interfaces.tracker import AnyTracker, Tracker

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
