"""Simulated time: it passes when all wait, in the order of what they wait for."""

import queue
import threading
import time

import pytest

from simulated_clock import simulated_clock
from truepath_drivers import host_clock


@pytest.fixture
def clock():
    begun_s = time.monotonic()
    with simulated_clock() as clock:
        yield clock
    assert time.monotonic() - begun_s < 5.0


def begin(*bodies):
    threads = [threading.Thread(target=body) for body in bodies]
    for thread in threads:
        thread.start()
    return threads


def test_hours_pass_at_once_and_then_the_time_of_the_computer_comes_back():
    with simulated_clock():
        before_s, wall_s = host_clock.now_s(), host_clock.wall_s()
        host_clock.sleep_s(1e6)
        assert host_clock.now_s() - before_s == pytest.approx(1e6)
        assert host_clock.wall_s() - wall_s == pytest.approx(1e6)
    assert host_clock.now_s() == pytest.approx(time.monotonic(), abs=1.0)


def test_sleepers_wake_in_the_order_of_their_ends(clock):
    seen = []

    def sleep(duration_s):
        for _ in range(3):
            host_clock.sleep_s(duration_s)
            seen.append(round(host_clock.now_s() - 1000.0, 6))

    for thread in begin(*(lambda s=s: sleep(s) for s in (0.5, 0.3, 7.0))):
        host_clock.join(thread)
    assert seen == sorted(seen)
    assert seen[-1] == 21.0


def test_no_time_passes_while_anybody_works(clock):
    ended = threading.Event()

    def work():
        end_s = time.monotonic() + 0.2
        while time.monotonic() < end_s:
            pass
        ended.set()

    begin(work)
    assert host_clock.wait(ended, 0.001)
    assert host_clock.now_s() == 1000.0


def test_an_event_that_comes_in_time_is_seen_before_the_timeout(clock):
    event = threading.Event()
    begin(lambda: (host_clock.sleep_s(9.9), event.set()))
    assert host_clock.wait(event, 10.0)
    assert host_clock.now_s() == pytest.approx(1009.9)
    event.clear()
    assert not host_clock.wait(event, 10.0)
    assert host_clock.now_s() == pytest.approx(1019.9)


def test_queues_conditions_and_calls_wait_on_it(clock):
    items, condition, given = queue.Queue(), threading.Condition(), []

    def give():
        host_clock.sleep_s(5.0)
        items.put("a")
        host_clock.sleep_s(5.0)
        with condition:
            given.append("b")
            condition.notify_all()

    (giver,) = begin(give)
    assert host_clock.get(items, 6.0) == "a"
    with pytest.raises(queue.Empty):
        host_clock.get(items, 1.0)
    with condition:
        assert not host_clock.wait_for(condition, lambda: bool(given), 1.0)
        assert host_clock.wait_for(condition, lambda: bool(given))
    host_clock.join(giver, 1.0)
    assert not giver.is_alive()
    assert host_clock.now_s() == pytest.approx(1010.0)


def test_a_thread_that_sleeps_elsewhere_does_not_hold_time_for_good(clock):
    lock = threading.Lock()
    lock.acquire()
    (blocked,) = begin(lock.acquire)
    host_clock.sleep_s(10.0)
    assert host_clock.now_s() == pytest.approx(1010.0)
    lock.release()
    blocked.join()
