"""What every test of a driver gets: no thread is left, waits have deadlines."""

import socket
import threading
import time

import pytest

from simulated_clock import simulated_clock


@pytest.fixture(autouse=True)
def no_thread_is_left():
    before = set(threading.enumerate())
    yield
    deadline = time.monotonic() + 2.0
    while set(threading.enumerate()) - before and time.monotonic() < deadline:
        time.sleep(0.005)
    assert set(threading.enumerate()) - before == set()


def wait_until(condition, timeout_s=5.0):
    deadline = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline, "the condition did not come true"
        time.sleep(0.002)


@pytest.fixture
def until():
    return wait_until


@pytest.fixture
def clock():
    """Let a test whose devices are in this process live on simulated time."""
    with simulated_clock() as clock:
        yield clock


@pytest.fixture
def free_port():
    with socket.create_server(("127.0.0.1", 0)) as server:
        return server.getsockname()[1]
