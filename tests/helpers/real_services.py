"""Real services over devices, and what a client does with them."""

import json
from contextlib import contextmanager, suppress

import psutil
from starlette.testclient import TestClient

import service_process
from service_process import arm, follow
from truepath.main import open_service
from truepath.service.api.application import create_application
from truepath.settings import load_settings
from truepath_simulators.machine_file import load_machine


def write_machine(place, rate_hz=100):
    """Write the file of the demo machine; its tracker sends a fifth of the samples."""
    file = place / "machine.json" if place.is_dir() else place
    content = load_machine("demo")
    content["tracker"]["rate_hz"] = rate_hz
    file.write_text(json.dumps(content))
    return file


def process(folder, descriptors=None, **environment):
    machine = {"TRUEPATH_MACHINE_FILE": str(write_machine(folder / "usual.json"))}
    return service_process.process(folder, descriptors, **machine | environment)


@contextmanager
def simulated_service(folder, rate_hz=100, **settings):
    file = write_machine(folder.with_name("usual-machine.json"), rate_hz)
    usual = {"simulated": True, "port": 0, "machine_file": file}
    with service_of(load_settings(data_dir=folder, **usual, **settings)) as opened:
        yield opened


@contextmanager
def service_of(settings):
    with open_service(settings) as service:
        app = create_application(service)
        with TestClient(app, base_url="http://localhost") as client:
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
