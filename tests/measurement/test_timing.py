from __future__ import annotations

import pytest

from truepath.measurement.faults import Fault
from truepath.measurement.monitors.controller_monitor import ControllerMonitor
from truepath.measurement.time_limits import EngineSettings, RunningClock, Stopwatch


def test_a_stopwatch_that_starts_at_zero_measures_from_there(hand_clock):
    stopwatch = Stopwatch()
    assert stopwatch.measure_s() == 0.0
    hand_clock.time_s = 2.5
    assert stopwatch.measure_s() == 2.5
    stopwatch.reset()
    assert stopwatch.measure_s() == 0.0


def test_a_controller_lost_at_time_zero_is_given_up_in_time(hand_clock, motion):
    motion.out_of_reach = True
    monitor = ControllerMonitor(motion, None, EngineSettings(link_s=2.0))
    assert monitor.poll() is None
    hand_clock.time_s = 2.1
    with pytest.raises(Fault, match="does not answer"):
        monitor.poll()


def test_of_a_long_step_a_running_clock_counts_little(hand_clock):
    running = RunningClock(0.25)
    hand_clock.time_s = 0.1
    assert running() == pytest.approx(0.1)
    hand_clock.time_s = 9.0
    assert running() == pytest.approx(0.35)
