"""A moment of a tracker at rest: what is heard of beam, rate and losses."""

from __future__ import annotations

import numpy as np
import pytest

from truepath.measurement.messages import TrackerTrial
from truepath.measurement.monitors.tracker_trial import try_tracker
from truepath_drivers.interfaces.records import LinkHealth, TrackerSamples
from truepath_drivers.interfaces.tracker import PolledTracker, Tracker


class Streaming(Tracker):
    """Sends blocks of ten samples, the first after some silence.

    rate_hz : that it keeps to; lost : samples between two blocks; status : of all;
    left : blocks of an earlier stream that nobody has read
    """

    def __init__(self, rate_hz=500.0, lost=0, status=0, silences=3, left=0):
        self.left, self.streams = left, False
        self.rate_hz, self.lost, self.status = rate_hz, lost, status
        self.silences, self.next, self.heard = silences, 0, []
        self.lost_samples = 0

    def connect(self):
        raise NotImplementedError

    def close(self):
        raise NotImplementedError

    def identity(self):
        raise NotImplementedError

    def start(self, rate_hz):
        self.heard.append(f"start {rate_hz:g}")
        self.streams = True

    def stop(self):
        self.heard.append("stop")
        self.streams = False

    @property
    def health(self):
        return LinkHealth(lost_samples=self.lost_samples)

    def read(self, timeout_s):
        if self.left:
            self.left -= 1
            return self.block(-1000.0)
        if not self.streams:
            return TrackerSamples.empty()
        if self.silences:
            self.silences -= 1
            return TrackerSamples.empty()
        return self.block()

    def block(self, later_s=0.0):
        sequence = np.arange(self.next, self.next + 10)
        self.next += 10 + self.lost
        self.lost_samples += self.lost
        place_mm = np.tile([0.0, 0.0, 2000.0], (10, 1))
        status = np.full(10, self.status, np.int64)
        time_s = later_s + sequence / self.rate_hz
        return TrackerSamples(sequence, time_s, place_mm, status)


class Polled(PolledTracker):
    """Fails the test where it is asked to measure."""

    connect = close = identity = stop = None

    @property
    def capabilities(self):
        raise NotImplementedError

    def measure(self, dwell_s):
        raise AssertionError("nobody asked for a point")


TRIAL = TrackerTrial(500.0, 0.01, streams_only=True)


@pytest.mark.parametrize("rate_hz", [500.0, 250.0])
@pytest.mark.parametrize("lost", [0, 5])
def test_the_rate_is_that_of_the_device_whatever_is_lost(rate_hz, lost):
    tracker = Streaming(rate_hz, lost)
    tried = try_tracker(tracker, TRIAL)
    assert tried.rate_hz == pytest.approx(rate_hz)
    assert tried.usable == tried.samples > 0
    assert bool(tried.lost_samples) == bool(lost)
    assert tried.distance_mm == pytest.approx(2000.0)
    assert tracker.heard == ["start 500", "stop"]


def test_what_an_earlier_stream_has_left_is_not_heard():
    tried = try_tracker(Streaming(left=3), TRIAL)
    assert tried.rate_hz == pytest.approx(500.0)


def test_samples_that_are_not_valid_are_counted_and_not_used():
    tried = try_tracker(Streaming(status=2), TRIAL)
    assert (tried.usable, tried.distance_mm) == (0, None)
    assert tried.samples > 0


def test_a_polled_tracker_is_left_alone():
    tried = try_tracker(Polled(), TRIAL)
    assert (tried.streams, tried.samples) == (False, 0)
