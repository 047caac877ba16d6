"""Lanes, blocks of a sum and science jobs, in real processes and on Dask."""

import json
import os
import re
import subprocess
import sys
import textwrap
import threading
import time
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from multiprocessing.resource_tracker import ensure_running
from pathlib import Path
from unittest.mock import Mock

import psutil
import pytest

import truepath
from processes import runs
from scripted_cell import wait_until
from truepath.catalogue.errors import Aborted, TaskFailed, WorkersAway
from truepath.catalogue.job import Job, JobKind
from truepath.catalogue.transitions import State
from truepath.errors import BadInput, BundleError, WorkerDied
from truepath.jobs.kinds.job_steps import RequestedJob
from truepath.jobs.workers import executor, reanalysis
from truepath.jobs.workers.analysis_tasks import analyse_recorded
from truepath.jobs.workers.workers import Workers, map_in_order, open_workers
from truepath.machines.machine_cells import Machines
from truepath.numerics.adaptive_trials import TrialPlan
from truepath.progress import ignore_progress

TASKS = """
import os, time
import numpy as np
from truepath.errors import BundleError
from truepath.numerics.adaptive_trials import BLOCK, summarise

prepared = []

def prepare():
    prepared.append(os.getpid())

def add(one, other, *, on_progress):
    on_progress(0.5, "half")
    on_progress(1.0, "whole")
    return one + other

def block(widths, number):
    rng = np.random.default_rng(np.random.SeedSequence(3, spawn_key=(number,)))
    drawn = widths[:, None] * rng.uniform(-1.0, 1.0, (len(widths), BLOCK))
    return summarise(np.cumsum(drawn, axis=0), "symmetric")

def about(number=0, *, on_progress=None):
    return {
        "number": number,
        "pid": os.getpid(),
        "threads": os.environ.get("OPENBLAS_NUM_THREADS"),
        "nice": os.nice(0),
        "prepared": prepared,
    }

def fail(number=0, *, on_progress=None):
    raise BundleError(f"no block {number}", file="tracker.csv", row=3)

def crash(number=0, *, on_progress=None):
    os._exit(9)

def sleep(file, number=0, *, on_progress=None):
    with open(f"{file}{number}", "w") as mark:
        mark.write(str(os.getpid()))
    time.sleep(60)
"""


@pytest.fixture(scope="module")
def tasks(import_code):
    return import_code("block_tasks", TASKS)


@pytest.fixture(scope="module")
def pair(tasks):
    with open_workers(Workers(count=2)) as mapper:
        list(mapper(tasks.about, range(2)))
        yield mapper


def test_the_answer_is_one_whoever_computes_and_however_many(tasks, pair, scheduler):
    import numpy as np

    from truepath.numerics.adaptive_trials import TrialPlan, propagate

    draw = partial(tasks.block, np.array([0.9, 0.5, 3.0]))
    plan = TrialPlan(seed=3, digits=2, most_blocks=9)

    def settled(mapper):
        told = propagate(draw, plan, mapper)
        columns = told.mean, told.sigma, told.low
        return told.trials, [column.tobytes() for column in columns]

    alone = settled(map)
    assert settled(pair) == alone
    for count in (0, 5):
        with open_workers(Workers("dask", count, scheduler)) as mapper:
            assert settled(mapper) == alone, count


def test_blocks_come_in_order_from_processes_with_one_thread_each(tasks, pair):
    told = list(pair(tasks.about, range(6)))
    assert [one["number"] for one in told] == list(range(6))
    assert os.getpid() not in {one["pid"] for one in told}
    assert {one["threads"] for one in told} == {"1"}


def test_no_more_is_under_way_than_there_are_workers():
    def compute(task, *arguments):
        done = Future()
        done.set_result(task(*arguments))
        return done

    pool = Mock()
    pool.submit.side_effect = compute
    assert next(iter(map_in_order(pool, 2)(str, range(100)))) == "0"
    assert pool.submit.call_count == 2


def test_what_a_block_raises_comes_back(tasks, pair, scheduler):
    with open_workers(Workers("dask", count=1, scheduler=scheduler)) as cluster:
        for mapper in (pair, cluster):
            with pytest.raises(BundleError, match="no block 0"):
                list(mapper(tasks.fail, range(3)))


@pytest.mark.fault_row(38)
def test_a_worker_that_dies_is_told_not_waited_for(tasks):
    workers, said = Workers(count=1), "ended without an answer"
    with open_workers(workers) as mapper, pytest.raises(WorkerDied, match=said):
        list(mapper(tasks.crash, range(3)))


def test_what_is_under_way_is_dropped_at_the_end(tasks, tmp_path):
    mark = str(tmp_path / "mark")
    with ThreadPoolExecutor() as pool:
        with open_workers(Workers(count=2)) as mapper:
            asking = pool.submit(list, mapper(partial(tasks.sleep, mark), range(2)))
            wait_until(lambda: len(list(tmp_path.iterdir())) == 2, "both")
            wait_until(lambda: all(f.read_text() for f in tmp_path.iterdir()))
            workers = [int(f.read_text()) for f in tmp_path.iterdir()]
        assert isinstance(asking.exception(10), WorkerDied)
    assert not any(psutil.pid_exists(pid) for pid in workers)


def test_workers_and_lanes_end_with_whoever_asked_even_if_it_is_killed(tasks, tmp_path):
    program = textwrap.dedent(
        f"""
        import sys, time
        sys.path.insert(0, {os.path.dirname(tasks.__file__)!r})
        import block_tasks
        from truepath.jobs.workers.executor import ProcessExecutor
        from truepath.jobs.workers.workers import Workers, open_workers
        from truepath.progress import ignore_progress

        if __name__ == "__main__":
            task = ProcessExecutor(1).submit(
                block_tasks.about, on_progress=ignore_progress, started=lambda: None
            )
            with open_workers(Workers(count=1)) as mapper:
                worker = next(iter(mapper(block_tasks.about, range(2))))
                print(worker["pid"], task.result()["pid"], flush=True)
                time.sleep(60)
        """
    )
    file = tmp_path / "program.py"
    file.write_text(program)
    pipes = dict.fromkeys(("stdout", "stderr"), subprocess.PIPE)
    with subprocess.Popen([sys.executable, file], text=True, **pipes) as parent:
        assert parent.stdout is not None
        children = [int(pid) for pid in parent.stdout.readline().split()]
        assert len(children) == 2
        parent.kill()
        _, said = parent.communicate(timeout=10)
    wait_until(lambda: not any(map(runs, children)), "the end of both")
    assert "leaked" not in said


def test_a_cluster_that_cannot_be_used_is_named(free_tcp_port, monkeypatch):
    distributed = pytest.importorskip("distributed")
    address = f"tcp://127.0.0.1:{free_tcp_port}"

    def refuse(match, scheduler, **patience):
        workers = Workers("dask", scheduler=scheduler, **patience)
        with pytest.raises(WorkersAway, match=match), open_workers(workers):
            pass

    refuse(f"no Dask scheduler answers at {address}", address, patience_s=0.5)
    how = {"protocol": "tcp://", "dashboard_address": "127.0.0.1:0"}
    with distributed.LocalCluster(n_workers=0, processes=False, **how) as cluster:
        refuse("has no workers", cluster.scheduler_address)
    with pytest.raises(BadInput, match="setting dask_scheduler: is empty"):
        Workers("dask").check()
    monkeypatch.setattr("truepath.jobs.workers.workers.find_spec", lambda name: None)
    with pytest.raises(BadInput, match=r"install truepath\[dask\]"):
        Workers("dask", scheduler="tcp://127.0.0.1:8786").check()


def test_dask_is_imported_only_where_it_is_chosen():
    at_once = re.compile(r"^(from|import) \S*(dask|distributed)", re.MULTILINE)
    files = Path(truepath.__file__).parent.rglob("*.py")
    found = [file.name for file in files if at_once.search(file.read_text())]
    assert found == ["dask_workers.py"]


@pytest.fixture(scope="module")
def lane(tasks):
    """One for all tests; what ends its process gets another."""
    lanes = executor.ProcessExecutor(1, tasks.prepare)
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
        mark = tmp_path / "mark0"
        computation = run(lanes, tasks.sleep, str(tmp_path / "mark"))
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
    with pytest.raises(TaskFailed, match=r"tracker.csv, row 3: no block 0") as raised:
        run(lane, tasks.fail).result()
    assert raised.value.family == "BundleError"
    assert "def fail" not in str(raised.value)
    assert 'raise BundleError(f"no block' in raised.value.trace
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
    answer = in_thread(lane.submit(tasks.add, 4, 5, **told).result)
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
    lanes = executor.ProcessExecutor(1, tasks.prepare)
    lanes.warm()
    about = run(lanes, tasks.about).result()
    assert about["prepared"] == [about["pid"]]
    _, outcome, _ = asleep(lanes)
    lanes.close()
    assert isinstance(outcome.exception(20), Aborted)
    with pytest.raises(Aborted):
        run(lanes, tasks.add, 1, 1).result()
    lanes.warm()


TWO_BLOCKS = TrialPlan(seed=5, most_blocks=2)


@pytest.fixture(scope="module")
def submit(lane, small_run, tmp_path_factory):
    def submit(plan, workers, on_progress=ignore_progress):
        folder = tmp_path_factory.mktemp("analysed") / "result"
        arguments = [str(small_run)], str(folder), False, plan, workers
        computation = run(lane, analyse_recorded, *arguments, on_progress=on_progress)
        return computation, folder

    return submit


@pytest.mark.long
def test_a_job_brings_the_same_trials_from_any_workers_or_a_cluster(submit, scheduler):
    def analyse(workers):
        told = []
        job, folder = submit(TWO_BLOCKS, workers, lambda _, stage: told.append(stage))
        job.result()
        stages = list(dict.fromkeys(told))
        assert stages == ["aligning", "estimating", "validating", "reporting"]
        assert "held against trials" in (folder / "report.html").read_text()
        return json.loads((folder / "result.json").read_text())["monte_carlo"]

    by_one = analyse(Workers(count=1))
    assert (by_one["seed"], by_one["trials"]) == (5, 20_000)
    assert analyse(Workers(count=2)) == by_one
    assert analyse(Workers("dask", scheduler=scheduler)) == by_one


@pytest.mark.timeout(200)  # workers give way to all else
def test_an_aborted_job_ends_its_workers_and_leaves_no_result(submit):
    trying = threading.Event()

    def on_progress(_, stage):
        if stage == "validating":
            trying.set()

    def list_children():
        return set(psutil.Process().children(recursive=True))

    ensure_running()  # multiprocessing's own helper, which outlives all jobs
    before = list_children()
    endless = TrialPlan(digits=2, most_blocks=10_000)
    job, folder = submit(endless, Workers(count=2), on_progress=on_progress)
    with ThreadPoolExecutor() as pool:
        outcome = pool.submit(job.result)
        assert trying.wait(150.0)
        job.cancel()
        assert isinstance(outcome.exception(30.0), Aborted)
    assert not folder.exists()
    wait_until(lambda: not list_children() - before, "the end of the workers")


@pytest.mark.long
def test_runs_are_held_against_before(lane, small_run, context, open_dispatcher, until):
    runs = []
    for name in "abc":
        upload = context.runs.make_upload_file()
        upload.write_bytes(small_run.read_bytes())
        runs.append(context.runs.add_uploaded(upload, name).id)
    earlier, _ = context.store.create(Job(JobKind.ANALYSE, run_id=runs[0]))
    folder = context.results / earlier.id
    order = [str(context.runs.file(runs[0]))], str(folder), False, None, Workers()
    analyse_recorded(*order, on_progress=ignore_progress)
    for state in (State.RUNNING, State.SUCCEEDED):
        context.store.change(earlier.id, lambda j, to=state: replace(j, state=to))
    context.runs.file(runs[1]).write_bytes(b"garbage")
    dispatcher = open_dispatcher(machines=Machines(), executor=lane)
    job, _ = dispatcher.create(RequestedJob(JobKind.REANALYSE, runs))
    until(job)
    summary = json.loads((context.results / job.id / reanalysis.SUMMARY).read_text())
    first, broken, third = summary["analyses"]
    result = json.loads((folder / "result.json").read_text())
    assert first["before_job"] == earlier.id
    before, after = dict(first["before"]), dict(first["after"])
    assert before == reanalysis.figures_of(result)
    assert after.pop("verdict") == before.pop("verdict")
    assert after == pytest.approx(before, rel=1e-9)  # whatever threads BLAS has
    assert broken["failure"]["family"] == "BundleError"
    assert "has been changed since it was catalogued" in broken["failure"]["detail"]
    assert (third["before"], third["after"]) == (None, first["after"])
    kept = context.results / job.id / "runs" / runs[0]
    assert json.loads((kept / "result.json").read_text())["verdict"]
    assert (kept / "error_tables.csv").is_file()
    assert not (context.results / job.id / "runs" / runs[1] / "result.json").exists()
