"""Real services over devices, and what a client does with them.

One that is a process of its own is forked where its code is imported already: an import
takes four seconds of a processor. All else is as `truepath serve` does it.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import sys
from contextlib import contextmanager, suppress
from types import ModuleType
from unittest import mock

import httpx2
import psutil
from starlette.testclient import TestClient

from service_process import SPEED, arm, follow
from serving import serve_forked
from truepath.main import open_service
from truepath.service.api.application import create_application
from truepath.settings import load_settings
from truepath_simulators.scenario import load_machine

START_S = 60.0
_FORKS = multiprocessing.get_context("forkserver")
_FORKS.set_forkserver_preload(["truepath.main", "truepath_simulators.bench.bench"])


def write_machine(file, rate_hz=100):
    """Write the file of the demo machine; its tracker sends a fifth of the samples."""
    content = load_machine("demo")
    content["tracker"]["rate_hz"] = rate_hz
    file.write_text(json.dumps(content))
    return file


@contextmanager
def process(folder, descriptors=None, **environment):
    """Run the service as its own process; yield it and a client of it.

    descriptors : it gets so many, and no more if it asks
    """
    settings = {
        "TRUEPATH_DATA_DIR": str(folder / "data"),
        "TRUEPATH_PORT": "0",
        "TRUEPATH_SIMULATED": "1",
        "TRUEPATH_SIMULATED_SPEED": str(SPEED),
        "TRUEPATH_MACHINE_FILE": str(folder / "usual-machine.json"),
        "TRUEPATH_LOG_FORMAT": "json",
        **environment,
    }
    write_machine(folder / "usual-machine.json")
    running = Service(settings, folder / "service.log", descriptors)
    try:
        with httpx2.Client(base_url=running.address, timeout=30.0) as client:
            yield running, client
    finally:
        running.close()


class Service:
    """A process of the service that answers; its verbs are those of a `Popen`."""

    def __init__(self, settings, log, descriptors):
        heard, told = _FORKS.Pipe(duplex=False)
        arguments = settings, str(log), told, descriptors
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


@contextmanager
def simulated_service(folder, **settings):
    file = write_machine(folder.with_name("usual-machine.json"))
    usual = {"simulated": True, "port": 0, "machine_file": file}
    chosen = load_settings(data_dir=folder, **usual, **settings)
    with service_of(chosen) as opened:
        yield opened


@contextmanager
def service_of(settings):
    with (
        open_service(settings) as service,
        TestClient(create_application(service), base_url="http://localhost") as client,
    ):
        yield service, client


def environment_of(motion, tracker, machine_file):
    if not machine_file.exists():
        write_machine(machine_file)
    return {
        "TRUEPATH_SIMULATED": "0",
        "TRUEPATH_MACHINE_FILE": str(machine_file),
        "TRUEPATH_TRACKER_OPTIONS": json.dumps(tracker),
        "TRUEPATH_MOTION_OPTIONS": json.dumps(motion),
    }


def drive(client, *ends, **order):
    """Order a job, arm it where it waits for that, follow it to its end."""
    answer = client.post("/api/v1/jobs", json={"kind": "measure-otf", **order})
    assert answer.status_code == 202, answer.text
    ends = ends or ("succeeded",)
    job = follow(client, answer.json()["id"], "ready", *ends, patience_s=120.0)
    if job["state"] == "ready":
        arm(client, job)
        job = follow(client, job["id"], *ends, patience_s=120.0)
    return job


def find_child(parent, role):
    for child in psutil.Process(parent).children(recursive=True):
        with suppress(psutil.NoSuchProcess):
            named = child.name().startswith(f"truepath-{role}")
            if named or f".{role}_process" in " ".join(child.cmdline()):
                return child
    return None
