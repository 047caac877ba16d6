"""What watches a measurement and what a cell says of it: in order, the latest."""

import threading
from dataclasses import replace
from itertools import pairwise
from multiprocessing import Pipe
from unittest.mock import Mock

import numpy as np
import pytest

from measurement_fixtures import FakePolledTracker, FakeTracker
from processes import until
from truepath.measurement import messages
from truepath.measurement.engine.measurement_monitor import DiskMonitor
from truepath.measurement.faults import Fault
from truepath.measurement.measurement_state import HoldReason, MeasurementState
from truepath.measurement.messages import TrackerTrial
from truepath.measurement.monitors.controller_monitor import ControllerMonitor, FeedHold
from truepath.measurement.monitors.stream_reader import StreamDamage, try_tracker
from truepath.measurement.process.cell_process import MAX_BLOCKS, Outbox
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


class Bench:
    """A measurement that only looks at its disk, on a clock of the test."""

    def __init__(self, motion, journal, clock):
        self.clock, self.disk = clock, Mock(failure="", is_space_low=False)
        self.turn_disk(slow=False)
        settings = EngineSettings()
        self.state = MeasurementState(lambda *_: None)
        machine = ControllerMonitor(motion, self.disk, settings)
        events = EventLog(self.disk, journal.report)
        feed = FeedHold(motion, machine, self.state, events, settings)
        self.monitor = DiskMonitor(feed, self.state, self.disk)

    def turn_disk(self, *, slow):
        self.disk.is_strained, self.disk.is_relaxed = slow, not slow

    def pass_time(self, seconds):
        for before, after in pairwise(range(round(10 * seconds) + 1)):
            self.clock.time_s += (after - before) / 10.0
            self.monitor.check()
            held, runs = (MotionState.HELD, "command"), (MotionState.RUNNING, "")
            self.state.observe(*(held if self.state.wants_hold else runs))


@pytest.mark.fault_row(28)
def test_a_disk_that_was_slow_for_long_waits_for_a_person(motion, journal, hand_clock):
    bench = Bench(motion, journal, hand_clock)
    bench.turn_disk(slow=True)
    bench.pass_time(60.0)
    bench.turn_disk(slow=False)
    bench.pass_time(60.0)
    assert bench.state.state == "paused"
    assert journal.faults == ["slow-disk", "disk-stays-slow"]
    bench.state.release(*HoldReason, text="resume")
    bench.pass_time(0.3)
    assert bench.state.state == "running"
    bench.turn_disk(slow=True)
    bench.pass_time(8.0)
    assert bench.state.state == "paused"
    bench.turn_disk(slow=False)
    bench.pass_time(0.3)
    assert bench.state.state == "running", "each time counts for itself"


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


def block(number):
    samples = TrackerSamples.empty()
    return messages.BlockRecorded(replace(samples, sequence=np.array([number])))


def state(text=""):
    return messages.StateChanged(messages.CellState.PAUSED, text)


def test_a_parent_that_is_gone_does_not_hang_the_outbox():
    ours, theirs = Pipe()
    outbox = Outbox(theirs)
    ours.close()
    outbox.report(state())
    outbox.close(5.0)
    assert not outbox._thread.is_alive()
    theirs.close()


class Reluctant:
    """A pipe's end whose other side takes nothing until it is told to."""

    def __init__(self):
        self.taken = []
        self.taking = threading.Event()
        self.asked = threading.Event()

    def send(self, event):
        self.asked.set()
        assert self.taking.wait(20.0)
        self.taken.append(event)


@pytest.fixture
def reluctant():
    link = Reluctant()
    outbox = Outbox(link)
    outbox.report(state())
    assert link.asked.wait(5.0)  # one event is on its way, the others wait
    yield link, outbox
    link.taking.set()
    outbox.close(5.0)


def test_blocks_that_nobody_takes_are_dropped_and_counted_and_nothing_else(reluctant):
    link, outbox = reluctant
    for number in range(MAX_BLOCKS + 7):
        outbox.report(block(number))
    outbox.report(messages.FaultReported("beam-lost", "", ""))
    outbox.report(state())
    assert outbox.dropped_blocks == 7
    link.taking.set()
    outbox.close(5.0)
    blocks = [e for e in link.taken if isinstance(e, messages.BlockRecorded)]
    assert [b.block.sequence[0] for b in blocks] == list(range(MAX_BLOCKS))
    names = [type(event).__name__ for event in link.taken]
    others = [name for name in names if name != "BlockRecorded"]
    assert others == ["StateChanged", "FaultReported", "StateChanged"]


def test_a_slow_parent_gets_the_latest_and_every_state_however_many_wait(reluctant):
    link, outbox = reluctant
    for number in range(2000):
        done = (number, 10, "lines", "measuring", 0.0, 0.0)
        outbox.report(messages.MeasurementProgress(*done))
        outbox.report(state(str(number)))
    link.taking.set()
    outbox.close(5.0)
    states = [e.text for e in link.taken[1:] if isinstance(e, messages.StateChanged)]
    assert states == [str(n) for n in range(2000)]
    done = [e.done for e in link.taken if isinstance(e, messages.MeasurementProgress)]
    assert done == [1999]


def test_there_is_room_for_blocks_again_once_they_are_taken(reluctant):
    link, outbox = reluctant
    for number in range(MAX_BLOCKS):
        outbox.report(block(number))
    link.taking.set()
    until(lambda: len(link.taken) > MAX_BLOCKS)
    outbox.report(block(MAX_BLOCKS))
    outbox.close(5.0)
    assert (outbox.dropped_blocks, link.taken[-1].block.sequence[0]) == (0, MAX_BLOCKS)
