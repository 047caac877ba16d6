"""Blocks on a real Dask cluster whose workers or scheduler die under them."""

import os
import signal
import subprocess
import sys
import time
from functools import partial

import psutil
import pytest
from distributed import Client

from scripted_cell import wait_until
from truepath.errors import WorkerDied
from truepath.jobs.workers.workers import Workers, open_workers

pytest.importorskip("distributed")
pytestmark = [pytest.mark.long, pytest.mark.timeout(120)]
PATIENCE_S = 5.0
TASKS = """
import os, time
import numpy as np

def draw(folder, pause_s, number):
    open(os.path.join(folder, f"{number}-{os.getpid()}"), "w").close()
    time.sleep(pause_s)
    seed = np.random.SeedSequence(3, spawn_key=(number,))
    return np.random.default_rng(seed).normal(size=50).tobytes()

def crash(home, number):
    if number == 2 and os.getpid() != home:
        os._exit(9)
    return number
"""


@pytest.fixture(scope="module")
def tasks(import_code):
    return import_code("lost_block_tasks", TASKS)


@pytest.fixture
def cluster(tasks, free_tcp_port):
    """A scheduler and two workers, processes of their own; the scheduler is first."""
    address = f"tcp://127.0.0.1:{free_tcp_port}"
    environment = os.environ | {"PYTHONPATH": os.path.dirname(tasks.__file__)}

    def start(program, options):
        words = [sys.executable, "-m", f"distributed.cli.{program}", *options.split()]
        quiet = dict.fromkeys(("stdout", "stderr"), subprocess.DEVNULL)
        how = {"env": environment, "start_new_session": True, **quiet}
        return subprocess.Popen(words, **how)

    at = f"--host 127.0.0.1 --port {free_tcp_port}"
    running = [start("dask_scheduler", f"{at} --no-dashboard --no-show")]
    options = f"{address} --nthreads 1 --no-dashboard --death-timeout 60"
    running += [start("dask_worker", options) for _ in range(2)]
    with Client(address, timeout=40, set_as_default=False) as client:
        client.wait_for_workers(2, timeout=40)
    yield address, running
    for process in running:
        for child in _tree(process.pid):
            child.kill()
        process.wait(10)


def _tree(pid):
    try:
        process = psutil.Process(pid)
        return [*process.children(recursive=True), process]
    except psutil.NoSuchProcess:
        return []


def _kill_worker(running, folder):
    """Kill a process that computes a block just now, whoever restarts it."""
    workers = {p.pid for r in running[1:] for p in _tree(r.pid)}
    named = sorted(folder.iterdir(), key=lambda f: f.stat().st_mtime)
    computing = [int(f.name.split("-")[1]) for f in named]
    os.kill(next(p for p in reversed(computing) if p in workers), signal.SIGKILL)


def _kill_workers(running, folder):
    for one in running[1:]:
        for process in _tree(one.pid):
            process.kill()


def _kill_scheduler(running, folder):
    running[0].kill()


def _freeze_scheduler(running, folder):
    running[0].send_signal(signal.SIGSTOP)


@pytest.mark.fault_row(38)
@pytest.mark.parametrize(
    "harm", [_kill_worker, _kill_workers, _kill_scheduler, _freeze_scheduler]
)
def test_the_same_bits_come_whoever_dies(tasks, cluster, tmp_path, harm, measured):
    address, running = cluster
    expected = [tasks.draw(str(tmp_path), 0.0, n) for n in range(12)]
    for file in tmp_path.iterdir():
        file.unlink()
    workers = Workers("dask", scheduler=address, patience_s=PATIENCE_S)
    begun = time.monotonic()
    with open_workers(workers) as mapper:
        blocks = iter(mapper(partial(tasks.draw, str(tmp_path), 0.4), range(12)))
        told = [next(blocks), next(blocks)]
        wait_until(lambda: len(list(tmp_path.iterdir())) > 2, "a block under way")
        harm(running, tmp_path)
        told += list(blocks)
        took_s = time.monotonic() - begun
        if harm is _kill_scheduler:  # whose client closes by itself after a time
            (client,) = (c for c in Client._instances if c.status != "closed")
            wait_until(lambda: client.status == "closed")
    assert took_s < 45.0
    done = harm.__name__.strip("_").replace("_", " ")
    measured(f"{done}: same bits in {took_s:.1f} s")
    assert told == expected


@pytest.mark.fault_row(38)
def test_a_block_that_ends_every_worker_is_given_up_by_name(tasks, cluster):
    workers = Workers("dask", scheduler=cluster[0], patience_s=20.0)
    said = "block 2 ended every worker"
    with open_workers(workers) as mapper, pytest.raises(WorkerDied, match=said):
        list(mapper(partial(tasks.crash, os.getpid()), range(4)))
