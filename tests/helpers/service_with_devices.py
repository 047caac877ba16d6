"""The real service, with devices that run beside it and do what a test orders."""

import time
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import httpx2

from real_services import environment_of, write_machine
from service_process import arm, create, process, wait_for
from truepath_simulators.bench.rig import Rig, running_rig

CONNECT = "/api/v1/machines/current:connect"
LONG_PATH = [
    {"x_mm": 20 + 450 * (n % 2), "y_mm": 20 + 5 * n, "z_mm": 150, "feed_mm_min": 900}
    for n in range(20)
]


@contextmanager
def running_devices(**options):
    with TemporaryDirectory() as folder:
        machine = {"machine": str(write_machine(Path(folder)))}
        with running_rig({"tracker": "tcp", "seed": 3, **machine, **options}) as rig:
            yield rig


@contextmanager
def service_of(rig, folder, **more):
    options = rig.motion_options, rig.tracker_options
    settings = environment_of(*options, folder / "machine.json")
    with process(folder, **settings, **more) as (_, client):
        yield client


def connect(client):
    wait_for(lambda: client.post(CONNECT).status_code == 200, "the devices")


def set_in_motion(client: httpx2.Client, rig: Rig) -> str:
    job = create(client, path=LONG_PATH)
    arm(client, job)
    wait_for(lambda: is_on_path(rig), "motion on the path")
    return job["id"]


def is_on_path(rig):
    control = rig.read_state()["cnc"]
    return control["state"] == "running" and control["line"] >= 1


def moves(rig):
    before = rig.read_position()["position"]
    time.sleep(0.2)
    return rig.read_position()["position"] != before
