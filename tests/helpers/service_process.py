"""The real service as a process of its own, and what a client does with it.

It is forked where its code is imported already: an import takes four seconds of a
processor. All else is as `truepath serve` does it.
"""

import multiprocessing
import os
import signal
import sys
import time
from contextlib import contextmanager
from types import ModuleType
from unittest import mock

import httpx2
import psutil

from api_builders import arm_over_http, rows_at
from serving import serve_forked

START_S = 60.0
_FORKS = multiprocessing.get_context("forkserver")
_FORKS.set_forkserver_preload(["truepath.main", "truepath_simulators.bench.bench"])
SPEED = 12.0
ENDS = {"succeeded", "failed", "faulted", "aborted", "cancelled", "interrupted"}
_PLACES = [(20, 20, 20), (480, 370, 280), (20, 200, 280), (450, 30, 150)]
_PLACES += [(100, 380, 30), (480, 200, 270), (30, 60, 100), (300, 380, 280)]
_PLACES += [(470, 30, 20), (20, 350, 200)]
ROWS = rows_at(*_PLACES, feed_mm_min=9000, dwell_s=0.6)


@contextmanager
def process(folder, descriptors=None, prepare=bool, **environment):
    """Run the service as its own process; yield it and a client of it.

    descriptors : it gets so many, and no more if it asks
    prepare : what it calls before it serves
    """
    settings = {
        "TRUEPATH_DATA_DIR": str(folder / "data"),
        "TRUEPATH_PORT": "0",
        "TRUEPATH_SIMULATED": "1",
        "TRUEPATH_SIMULATED_SPEED": str(SPEED),
        "TRUEPATH_LOG_FORMAT": "json",
        **environment,
    }
    running = Service(settings, folder / "service.log", descriptors, prepare)
    try:
        with httpx2.Client(base_url=running.address, timeout=30.0) as client:
            yield running, client
    finally:
        running.close()


class Service:
    """A process of the service that answers; its verbs are those of a `Popen`."""

    def __init__(self, settings, log, descriptors, prepare):
        heard, told = _FORKS.Pipe(duplex=False)
        arguments = settings, str(log), told, descriptors, prepare
        self._process = _FORKS.Process(target=serve_forked, args=arguments)
        # Nothing of the program that tests is run anew in the child.
        with mock.patch.dict(sys.modules, {"__main__": ModuleType("__main__")}):
            self._process.start()
        told.close()
        self.pid, self.kill = self._process.pid, self._process.kill
        try:
            assert heard.poll(START_S), log.read_text()
            self.address = heard.recv()
        except EOFError:
            raise AssertionError(log.read_text()) from None
        finally:
            heard.close()

    def poll(self):
        return self._process.exitcode

    def send_signal(self, number):
        os.kill(self.pid, number)

    def wait(self, patience_s):
        self._process.join(patience_s)
        assert self.poll() is not None, "the service does not end"
        return self.poll()

    def close(self):
        if self.poll() is None:
            self.send_signal(signal.SIGTERM)
        self.wait(20)
        self._process.close()


def create(client, **order):
    answer = client.post("/api/v1/jobs", json={"kind": "measure-otf", **order})
    assert answer.status_code == 202, answer.text
    return follow(client, answer.json()["id"], "ready")


def arm(client, job):
    def is_armed():
        answer = arm_over_http(client, job)
        if answer.status_code == 409 and answer.json()["code"] == "not-in-order":
            return False
        assert answer.status_code == 202, answer.text
        return True

    wait_for(is_armed, "the conditions", 30.0)


def follow(client, job_id, *states, patience_s=50.0):
    """Wait for a job; on a busy computer as long as it gets on at all."""
    last = None
    while True:
        job = client.get(f"/api/v1/jobs/{job_id}").json()
        if job["state"] in states:
            return job
        assert job["state"] not in ENDS, job["error"]
        here = job["state"], job["stage"], job["progress"]["done"]
        if here != last:
            last, end = here, time.monotonic() + patience_s
        assert time.monotonic() < end, job
        time.sleep(0.1)


def acknowledge(client, job_id):
    answer = client.post(f"/api/v1/jobs/{job_id}/acknowledge")
    assert answer.status_code == 202, answer.text
    return follow(client, job_id, "ready")


def moving(client, job_id):
    address = f"/api/v1/jobs/{job_id}"
    wait_for(lambda: client.get(address).json()["health"]["samples"] > 500, "samples")


def begin_moving(client, rows=ROWS):
    job = create(client, path=rows)
    arm(client, job)
    moving(client, job["id"])
    return job["id"]


def wait_for(reached, what, patience_s=90.0):
    """Wait for what may take minutes on a busy computer."""
    end = time.monotonic() + patience_s
    while not reached():
        assert time.monotonic() < end, f"waited in vain for {what}"
        time.sleep(0.1)


def wait_until_done(client, job_id, number, kind="measure-otf"):
    unit = "lines" if kind == "measure-otf" else "points"

    def is_done():
        job = client.get(f"/api/v1/jobs/{job_id}").json()
        assert job["state"] not in ENDS, job
        progress = job["progress"]
        return progress["unit"] == unit and progress["done"] >= number

    wait_for(is_done, "the first lines")


def kill(service):
    children = psutil.Process(service.pid).children(recursive=True)
    service.kill()
    service.wait(10)
    psutil.wait_procs(children, timeout=20)
