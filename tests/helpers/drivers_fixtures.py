"""What every test of a driver gets: no thread is left, waits have deadlines."""

import threading
import time

import pytest

from processes import until as until_met
from simulated_clock import simulated_clock


@pytest.fixture(autouse=True)
def no_thread_is_left():
    before = set(threading.enumerate())
    yield
    deadline = time.monotonic() + 2.0
    while set(threading.enumerate()) - before and time.monotonic() < deadline:
        time.sleep(0.005)
    assert set(threading.enumerate()) - before == set()


@pytest.fixture
def until():
    return until_met


@pytest.fixture
def clock():
    """Let a test whose devices are in this process live on simulated time."""
    with simulated_clock() as clock:
        yield clock
