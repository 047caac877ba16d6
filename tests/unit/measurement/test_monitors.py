"""What watches a measurement: damage of the stream, time, a slow disk, a trial."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest

from measurement_fixtures import FakePolledTracker, FakeTracker
from truepath.measurement.engine.measurement_monitor import DiskMonitor
from truepath.measurement.faults import Fault
from truepath.measurement.measurement_state import HoldReason, MeasurementState
from truepath.measurement.messages import TrackerTrial
from truepath.measurement.monitors.controller_monitor import ControllerMonitor, FeedHold
from truepath.measurement.monitors.stream_reader import StreamDamage, try_tracker
from truepath.measurement.run_file.recorder import EventLog
from truepath.measurement.time_limits import EngineSettings
from truepath_drivers.interfaces.records import MotionState, TrackerSamples

RATE_HZ = 500.0


def samples(number):
    n = len(number)
    return TrackerSamples(number, number / RATE_HZ, np.zeros((n, 3)), np.zeros(n, int))


def judge(number, crc_errors=0):
    damage = StreamDamage(RATE_HZ, 0.01)
    found = False
    for i, block in enumerate(np.array_split(number, len(number) // 10)):
        damage.note(samples(block), 7 + (crc_errors * i) // 50)
        found = found or damage.is_over_limit
    return found


@pytest.mark.parametrize(
    ("lost", "is_damaged"), [(0, False), (5, False), (8, True), (380, True)]
)
def test_more_than_a_hundredth_of_a_second_is_damage(rng, lost, is_damaged):
    number = np.arange(2000)
    keep = np.ones(2000, bool)
    keep[1000 + rng.choice(400, lost, replace=False)] = False
    assert judge(number[keep]) == is_damaged


def test_one_gap_is_a_silence_and_damage_is_over_after_a_good_second():
    number = np.arange(2000)
    assert not judge(number[(number < 800) | (number > 1100)])
    damage = StreamDamage(RATE_HZ, 0.01)
    damage.note(samples(np.arange(0, 1000, 20)), 0)
    assert damage.is_over_limit
    damage.note(samples(np.arange(1000, 1600)), 0)
    assert not damage.is_over_limit


@pytest.mark.parametrize(("crc_errors", "is_damaged"), [(3, False), (12, True)])
def test_frames_that_do_not_check_are_damage(crc_errors, is_damaged):
    assert judge(np.arange(1000), crc_errors) == is_damaged


def test_a_controller_lost_at_time_zero_is_given_up_in_time(hand_clock, motion):
    motion.out_of_reach = True
    monitor = ControllerMonitor(motion, None, EngineSettings(link_s=2.0))
    assert monitor.poll() is None
    hand_clock.time_s = 2.1
    with pytest.raises(Fault, match="does not answer"):
        monitor.poll()


# A slow disk holds the feed; after some seconds only a person lets it go on.


@dataclass
class Disk:
    """Stands for the recorder: the test says how much waits."""

    failure: str = ""
    is_space_low: bool = False
    is_strained: bool = False
    is_relaxed: bool = True

    def event(self, kind, text):
        pass

    def turn(self, *, slow):
        self.is_strained, self.is_relaxed = slow, not slow


class Bench:
    """A measurement that only looks at its disk, on a clock of the test."""

    def __init__(self, motion, journal, clock):
        self.clock, self.disk = clock, Disk()
        settings = EngineSettings()
        self.state = MeasurementState(lambda *_: None)
        machine = ControllerMonitor(motion, self.disk, settings)
        events = EventLog(self.disk, journal.report)
        feed = FeedHold(motion, machine, self.state, events, settings)
        self.monitor = DiskMonitor(feed, self.state, self.disk)

    def pass_time(self, seconds):
        for before, after in pairwise(range(round(10 * seconds) + 1)):
            self.clock.time_s += (after - before) / 10.0
            self.monitor.check()
            held, runs = (MotionState.HELD, "command"), (MotionState.RUNNING, "")
            self.state.observe(*(held if self.state.wants_hold else runs))


@pytest.fixture
def bench(motion, journal, hand_clock):
    return Bench(motion, journal, hand_clock)


@pytest.mark.fault_row(28)
def test_a_disk_that_was_slow_for_long_waits_for_a_person(bench, journal):
    bench.disk.turn(slow=True)
    bench.pass_time(60.0)
    bench.disk.turn(slow=False)
    bench.pass_time(60.0)
    assert bench.state.state == "paused"
    assert journal.faults == ["slow-disk", "disk-stays-slow"]
    bench.state.release(*HoldReason, text="resume")
    bench.pass_time(0.3)
    assert bench.state.state == "running"
    bench.disk.turn(slow=True)
    bench.pass_time(8.0)
    assert bench.state.state == "paused"
    bench.disk.turn(slow=False)
    bench.pass_time(0.3)
    assert bench.state.state == "running", "each time counts for itself"


# A moment of a tracker at rest: what is heard of beam, rate and losses.


class Streaming(FakeTracker):
    """Sends blocks of ten samples, the first after some silence.

    lost : samples between two blocks; status : of all;
    left : blocks of an earlier stream that nobody has read
    """

    def __init__(self, rate_hz=500.0, lost=0, status=0, left=0):
        super().__init__()
        self.rate_hz, self.lost, self.status, self.left = rate_hz, lost, status, left
        self.silences, self.next, self.heard = 3, 0, []

    def start(self, rate_hz):
        super().start(rate_hz)
        self.heard.append(f"start {rate_hz:g}")

    def stop(self):
        super().stop()
        self.heard.append("stop")

    def read(self, timeout_s):
        if self.left:
            self.left -= 1
            return self.block(-1000.0)
        if not self.streaming or self.silences:
            self.silences -= self.streaming
            return TrackerSamples.empty()
        return self.block()

    def block(self, by_s=0.0):
        sequence = np.arange(self.next, self.next + 10)
        self.next += 10 + self.lost
        place = np.tile([0.0, 0.0, 2000.0], (10, 1))
        status = np.full(10, self.status, np.int64)
        return TrackerSamples(sequence, by_s + sequence / self.rate_hz, place, status)


class Polled(FakePolledTracker):
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


def test_an_earlier_stream_invalid_samples_and_polled_trackers_are_left_alone():
    tried = try_tracker(Streaming(left=3), TRIAL)
    assert tried.rate_hz == pytest.approx(500.0)
    tried = try_tracker(Streaming(status=2), TRIAL)
    assert (tried.usable, tried.distance_mm) == (0, None)
    assert tried.samples > 0
    tried = try_tracker(Polled(), TRIAL)
    assert (tried.streams, tried.samples) == (False, 0)
