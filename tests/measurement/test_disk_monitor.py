"""A slow disk holds the feed; after some seconds only a person lets it go on."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import pytest

from truepath.measurement.engine.measurement_monitor import DiskMonitor
from truepath.measurement.measurement_state import HoldReason, MeasurementState
from truepath.measurement.monitors.controller_monitor import ControllerMonitor
from truepath.measurement.monitors.feed_hold import FeedHold
from truepath.measurement.run_file.event_log import EventLog
from truepath.measurement.time_limits import EngineSettings
from truepath_drivers.interfaces.records import MotionState


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
        self.monitor = DiskMonitor(feed, self.state, self.disk, settings)

    def pass_time(self, seconds):
        for before, after in pairwise(range(round(10 * seconds) + 1)):
            self.clock.time_s += (after - before) / 10.0
            self.monitor.check()
            stands = self.state.wants_hold
            self.state.observe(
                MotionState.HELD if stands else MotionState.RUNNING,
                "command" if stands else "",
            )


@pytest.fixture
def bench(motion, journal, hand_clock):
    return Bench(motion, journal, hand_clock)


def test_a_disk_that_catches_up_within_seconds_goes_on_by_itself(bench, journal):
    bench.disk.turn(slow=True)
    bench.pass_time(8.0)
    assert bench.state.state == "paused"
    bench.disk.turn(slow=False)
    bench.pass_time(0.3)
    assert bench.state.state == "running"
    assert journal.faults == ["slow-disk"]


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
    bench.disk.turn(slow=False)
    bench.pass_time(0.3)
    assert bench.state.state == "running", "each time counts for itself"
