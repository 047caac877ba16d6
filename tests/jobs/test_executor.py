"""Lanes in real processes. The tasks live in a module that the processes can import."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import threading
import time

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


@pytest.fixture
def one_lane(tasks):
    lanes = ProcessExecutor(1, tasks.prepare)
    yield lanes
    lanes.close()


def run(lanes, task, *arguments, on_progress=ignore_progress):
    return lanes.submit(task, *arguments, on_progress=on_progress, started=lambda: None)


def test_a_task_computes_elsewhere_and_reports(one_lane, tasks):
    reports = []
    computation = run(
        one_lane, tasks.add, 2, 3, on_progress=lambda *told: reports.append(told)
    )
    assert computation.result() == 5
    assert reports == [(0.5, "half"), (1.0, "whole")]


def test_progress_that_cannot_be_reported_ends_nothing(one_lane, tasks):
    before = run(one_lane, tasks.about).result()["pid"]

    def fail(share, stage):
        raise OSError("nobody listens")

    assert run(one_lane, tasks.add, 2, 3, on_progress=fail).result() == 5
    assert run(one_lane, tasks.about).result()["pid"] == before


def test_a_lane_is_prepared_polite_and_single_threaded(one_lane, tasks):
    about = run(one_lane, tasks.about).result()
    assert about["pid"] != os.getpid()
    assert about["threads"] == "1"
    assert about["nice"] >= 10
    assert about["prepared"] == [about["pid"]]


def test_what_a_task_raises_comes_back_by_name_and_text(one_lane, tasks):
    with pytest.raises(TaskFailed, match=r"tracker.csv, row 3: is NaN") as raised:
        run(one_lane, tasks.fail).result()
    assert raised.value.family == "BundleError"
    assert "def fail" not in str(raised.value)
    assert 'raise BundleError("is NaN"' in raised.value.trace
    assert run(one_lane, tasks.add, 1, 1).result() == 2


def test_a_process_that_dies_is_named_and_replaced(one_lane, tasks):
    before = run(one_lane, tasks.about).result()["pid"]
    with pytest.raises(WorkerDied, match="killed, or out of memory"):
        run(one_lane, tasks.crash).result()
    assert run(one_lane, tasks.about).result()["pid"] != before


def test_a_task_that_is_cancelled_ends_whatever_it_does(one_lane, tasks, tmp_path):
    mark = tmp_path / "mark"
    computation = run(one_lane, tasks.sleep, str(mark))
    outcome = in_thread(computation.result)
    wait_until(lambda: mark.is_file() and mark.read_text(), "the task")
    begun = time.monotonic()
    computation.cancel()
    computation.cancel()
    assert isinstance(outcome(), Aborted)
    assert time.monotonic() - begun < 5
    with pytest.raises(ProcessLookupError):
        os.kill(int(mark.read_text()), 0)
    assert run(one_lane, tasks.add, 1, 2).result() == 3


def test_a_task_in_line_begins_when_the_lane_is_free(one_lane, tasks, tmp_path):
    mark = tmp_path / "mark"
    first = run(one_lane, tasks.sleep, str(mark))
    outcome = in_thread(first.result)
    wait_until(lambda: mark.is_file() and mark.read_text(), "the first")
    started = threading.Event()
    second = one_lane.submit(
        tasks.add, 4, 5, on_progress=ignore_progress, started=started.set
    )
    answer = in_thread(second.result)
    assert not started.is_set()
    first.cancel()
    assert isinstance(outcome(), Aborted)
    assert answer() == 9
    assert started.is_set()


def test_a_task_in_line_can_be_cancelled(one_lane, tasks, tmp_path):
    mark = tmp_path / "mark"
    first = run(one_lane, tasks.sleep, str(mark))
    outcome = in_thread(first.result)
    wait_until(lambda: mark.is_file() and mark.read_text(), "the first")
    second = run(one_lane, tasks.add, 4, 5)
    answer = in_thread(second.result)
    second.cancel()
    assert isinstance(answer(), Aborted)
    first.cancel()
    assert isinstance(outcome(), Aborted)


def test_closing_ends_what_runs_and_refuses_what_comes(tasks, tmp_path):
    lanes = ProcessExecutor(1)
    mark = tmp_path / "mark"
    outcome = in_thread(run(lanes, tasks.sleep, str(mark)).result)
    wait_until(lambda: mark.is_file() and mark.read_text(), "the task")
    lanes.close()
    assert isinstance(outcome(), Aborted)
    with pytest.raises(Aborted):
        run(lanes, tasks.add, 1, 1).result()


def test_a_warm_lane_has_its_process_before_the_first_task(tasks):
    lanes = ProcessExecutor(1, tasks.prepare)
    lanes.warm()
    about = run(lanes, tasks.about).result()
    assert about["prepared"] == [about["pid"]]
    lanes.close()
    lanes.warm()


def test_the_processes_end_with_the_service_even_if_it_is_killed(tasks, tmp_path):
    program = textwrap.dedent(
        f"""
        import sys, time
        sys.path.insert(0, {os.path.dirname(tasks.__file__)!r})
        import lane_tasks
        from truepath.jobs.workers.executor import ProcessExecutor
        from truepath.progress import ignore_progress

        if __name__ == "__main__":
            lanes = ProcessExecutor(1)
            task = lanes.submit(
                lane_tasks.about, on_progress=ignore_progress, started=lambda: None
            )
            print(task.result()["pid"], flush=True)
            time.sleep(60)
        """
    )
    file = tmp_path / "program.py"
    file.write_text(program)
    with subprocess.Popen([sys.executable, file], stdout=subprocess.PIPE) as parent:
        assert parent.stdout is not None
        child = int(parent.stdout.readline())
        parent.send_signal(signal.SIGKILL)

    def gone():
        try:
            os.kill(child, 0)
        except ProcessLookupError:
            return True
        with open(f"/proc/{child}/stat") as stat:
            return stat.read().split()[2] == "Z"  # nobody has reaped it yet

    wait_until(gone, "the lane's end")


def in_thread(call):
    """Run a call in a thread; return a function that gives its value or its error."""
    outcome = []

    def body():
        try:
            outcome.append(call())
        except Exception as error:
            outcome.append(error)

    thread = threading.Thread(target=body)
    thread.start()

    def answer():
        thread.join(20)
        assert not thread.is_alive()
        return outcome[0]

    return answer
