"""Clocks of simulated devices that do not always run."""

from __future__ import annotations

import pytest

from truepath_simulators.machine_clock import AwakeClock


class HandClock:
    """A clock that stands until the test lets time pass."""

    now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


def test_a_device_that_runs_counts_all_of_the_time():
    hand = HandClock()
    clock = AwakeClock(0.1, hand)
    begin_s = clock()
    for _ in range(300):
        hand.now_s += 0.01
        clock()
    assert clock() - begin_s == pytest.approx(3.0)


def test_a_device_that_was_suspended_counts_a_moment_of_it():
    hand = HandClock()
    clock = AwakeClock(0.1, hand)
    begin_s = clock()
    hand.now_s += 3600.0
    assert clock() - begin_s == pytest.approx(0.1)
    assert clock() - begin_s == pytest.approx(0.1)
