"""The real service, with devices that run beside it and do what a test orders."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import httpx2

from service_process import arm, create, process, wait_for
from truepath_simulators.bench.rig import Rig, running_rig
from truepath_simulators.scenario import load_machine

CONNECT = "/api/v1/machines/current:connect"
RATE_HZ = 100.0
LONG_PATH = [
    {"x_mm": 20 + 450 * (n % 2), "y_mm": 20 + 5 * n, "z_mm": 150, "feed_mm_min": 900}
    for n in range(20)
]


def write_machine(folder: Path) -> Path:
    """Write the file of a machine whose tracker tells a fifth of the usual samples."""
    content = load_machine("demo")
    content["tracker"]["rate_hz"] = RATE_HZ
    file = folder / "machine.json"
    file.write_text(json.dumps(content))
    return file


@contextmanager
def running_devices(**options: Any) -> Iterator[Rig]:
    """Run a tracker and a control of that machine."""
    with TemporaryDirectory() as folder:
        machine = {"machine": str(write_machine(Path(folder)))}
        with running_rig({"tracker": "tcp", "seed": 3, **machine, **options}) as rig:
            yield rig


@contextmanager
def service_of(rig: Rig, folder: Path, **more: str) -> Iterator[httpx2.Client]:
    """Run the service of these devices; yield a client of it."""
    settings = {
        "TRUEPATH_SIMULATED": "0",
        "TRUEPATH_MACHINE_FILE": str(write_machine(folder)),
        "TRUEPATH_TRACKER_OPTIONS": json.dumps(rig.tracker_options),
        "TRUEPATH_MOTION_OPTIONS": json.dumps(rig.motion_options),
    }
    with process(folder, **settings, **more) as (_, client):
        yield client


def connect(client: httpx2.Client) -> None:
    """Connect the devices, once they listen."""
    wait_for(lambda: client.post(CONNECT).status_code == 200, "the devices")


def set_in_motion(client: httpx2.Client, rig: Rig) -> str:
    """Drive a long slow path; return its job."""
    job = create(client, path=LONG_PATH)
    arm(client, job)
    wait_for(lambda: is_on_path(rig), "motion on the path")
    return job["id"]


def is_on_path(rig: Rig) -> bool:
    """Whether the control drives the path."""
    control = rig.read_state()["cnc"]
    return control["state"] == "running" and control["line"] >= 1


def moves(rig: Rig) -> bool:
    """Whether the machine truly moves."""
    before = rig.read_position()["position"]
    time.sleep(0.2)
    return rig.read_position()["position"] != before
