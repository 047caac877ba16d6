"""Lanes in real processes. The tasks live in a module that the processes can import."""

import os
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from unittest.mock import Mock

import pytest

from scripted_cell import wait_until
from truepath.catalogue.errors import Aborted, TaskFailed
from truepath.errors import WorkerDied
from truepath.jobs.workers.executor import ProcessExecutor
from truepath.progress import ignore_progress

TASKS = """
import os, time
from truepath.errors import BundleError

prepared = []

def prepare():
    prepared.append(os.getpid())

def add(one, other, *, on_progress):
    on_progress(0.5, "half")
    on_progress(1.0, "whole")
    return one + other

def about(*, on_progress):
    return {
        "pid": os.getpid(),
        "threads": os.environ["OPENBLAS_NUM_THREADS"],
        "nice": os.nice(0),
        "prepared": prepared,
    }

def fail(*, on_progress):
    raise BundleError("is NaN", file="tracker.csv", row=3)

def crash(*, on_progress):
    os._exit(9)

def sleep(file, *, on_progress):
    on_progress(0.0, "asleep")
    with open(file, "w") as mark:
        mark.write(str(os.getpid()))
    time.sleep(60)
"""


@pytest.fixture(scope="module")
def tasks(import_code):
    return import_code("lane_tasks", TASKS)


@pytest.fixture(scope="module")
def lane(tasks):
    """One for all tests; what ends its process gets another."""
    lanes = ProcessExecutor(1, tasks.prepare)
    yield lanes
    lanes.close()


def run(lanes, task, *arguments, on_progress=ignore_progress):
    return lanes.submit(task, *arguments, on_progress=on_progress, started=lambda: None)


@pytest.fixture
def in_thread():
    with ThreadPoolExecutor() as pool:
        yield pool.submit


@pytest.fixture
def asleep(tasks, tmp_path, in_thread):
    def begin(lanes):
        mark = tmp_path / "mark"
        computation = run(lanes, tasks.sleep, str(mark))
        outcome = in_thread(computation.result)
        wait_until(lambda: mark.is_file() and mark.read_text(), "the task")
        return computation, outcome, int(mark.read_text())

    return begin


def test_a_task_computes_in_a_prepared_polite_and_single_threaded_process(lane, tasks):
    reports = Mock()
    assert run(lane, tasks.add, 2, 3, on_progress=reports).result() == 5
    assert [told.args for told in reports.mock_calls] == [(0.5, "half"), (1.0, "whole")]
    about = run(lane, tasks.about).result()
    assert about["pid"] != os.getpid()
    assert about["threads"] == "1"
    assert about["nice"] >= 10
    assert about["prepared"] == [about["pid"]]


def test_only_a_task_that_crashes_ends_its_process_which_is_replaced(lane, tasks):
    before = run(lane, tasks.about).result()["pid"]
    with pytest.raises(TaskFailed, match=r"tracker.csv, row 3: is NaN") as raised:
        run(lane, tasks.fail).result()
    assert raised.value.family == "BundleError"
    assert "def fail" not in str(raised.value)
    assert 'raise BundleError("is NaN"' in raised.value.trace
    away = Mock(side_effect=OSError("nobody listens"))
    assert run(lane, tasks.add, 2, 3, on_progress=away).result() == 5
    assert run(lane, tasks.about).result()["pid"] == before
    with pytest.raises(WorkerDied, match="killed, or out of memory"):
        run(lane, tasks.crash).result()
    assert run(lane, tasks.about).result()["pid"] != before


def test_a_cancelled_task_ends_and_the_next_begins(lane, tasks, asleep, in_thread):
    first, outcome, pid = asleep(lane)
    started = threading.Event()
    waits = run(lane, tasks.add, 4, 5)
    called_off = in_thread(waits.result)
    waits.cancel()
    assert isinstance(called_off.exception(20), Aborted)
    told = {"on_progress": ignore_progress, "started": started.set}
    second = lane.submit(tasks.add, 4, 5, **told)
    answer = in_thread(second.result)
    assert not started.is_set()
    begun = time.monotonic()
    first.cancel()
    first.cancel()
    assert isinstance(outcome.exception(20), Aborted)
    assert time.monotonic() - begun < 5
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)
    assert answer.result(20) == 9
    assert started.is_set()


def test_a_warm_lane_has_its_process_at_once_and_none_once_closed(tasks, asleep):
    lanes = ProcessExecutor(1, tasks.prepare)
    lanes.warm()
    about = run(lanes, tasks.about).result()
    assert about["prepared"] == [about["pid"]]
    _, outcome, _ = asleep(lanes)
    lanes.close()
    assert isinstance(outcome.exception(20), Aborted)
    with pytest.raises(Aborted):
        run(lanes, tasks.add, 1, 1).result()
    lanes.warm()
