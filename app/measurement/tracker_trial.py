"""A moment of the tracker's stream, to see that it measures. Nothing moves."""

from __future__ import annotations

import time

import numpy as np

from truepath.app.measurement.messages import TrackerTrial, TrackerTried
from truepath.drivers.interfaces.records import TrackerSamples
from truepath.drivers.interfaces.tracker import AnyTracker, Tracker

_READ_S = 0.2


def try_tracker(tracker: AnyTracker, trial: TrackerTrial) -> TrackerTried:
    """Return what a connected tracker sends in a while. Raises DeviceError."""
    if not isinstance(tracker, Tracker):
        point = tracker.measure(trial.duration_s)
        distance_mm = float(np.linalg.norm(point.position_mm))
        return TrackerTried(point.count, point.count, 0, distance_mm)
    lost_before = tracker.health.lost_samples
    blocks: list[TrackerSamples] = []
    tracker.start(trial.rate_hz)
    try:
        end_s = time.monotonic() + trial.duration_s
        while time.monotonic() < end_s:
            blocks.append(tracker.read(_READ_S))
    finally:
        tracker.stop()
    lost = tracker.health.lost_samples - lost_before
    usable_mm = [b.position_mm[b.status == 0] for b in blocks if len(b)]
    distances_mm = [np.linalg.norm(block, axis=1) for block in usable_mm]
    found_mm = np.concatenate([*distances_mm, np.zeros(0)])
    mean_mm = float(found_mm.mean()) if len(found_mm) else None
    return TrackerTried(sum(map(len, blocks)), len(found_mm), lost, mean_mm)
