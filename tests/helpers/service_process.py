"""The real service as a process of its own, and what a client does with it."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from contextlib import contextmanager

import httpx2
import psutil

from arming import arm_over_http

PROGRAM = """
import sys
from truepath.main import serve
from truepath.settings import load_settings

if __name__ == "__main__":
    serve(load_settings())
"""
SPEED = 12.0
ENDS = {"succeeded", "failed", "faulted", "aborted", "cancelled", "interrupted"}
ROWS = [
    {"x_mm": x, "y_mm": y, "z_mm": z, "feed_mm_min": 9000, "dwell_s": 0.6}
    for x, y, z in [
        (20, 20, 20),
        (480, 370, 280),
        (20, 200, 280),
        (450, 30, 150),
        (100, 380, 30),
        (480, 200, 270),
        (30, 60, 100),
        (300, 380, 280),
        (470, 30, 20),
        (20, 350, 200),
    ]
]


@contextmanager
def process(tmp_path, **environment):
    program = tmp_path / "service.py"
    program.write_text(PROGRAM)
    settings = {
        "TRUEPATH_DATA_DIR": str(tmp_path / "data"),
        "TRUEPATH_PORT": "0",
        "TRUEPATH_SIMULATED": "1",
        "TRUEPATH_SIMULATED_SPEED": str(SPEED),
        "TRUEPATH_LOG_FORMAT": "json",
        **environment,
    }
    log = (tmp_path / "service.log").open("a")
    running = subprocess.Popen(
        [sys.executable, program],
        stdout=subprocess.PIPE,
        stderr=log,
        text=True,
        env=os.environ | settings,
        start_new_session=True,
    )
    try:
        lines = [running.stdout.readline() for _ in range(4)]
        page = next((x.split()[1] for x in lines if x.split()[:1] == ["page"]), None)
        assert page, (tmp_path / "service.log").read_text()
        with httpx2.Client(base_url=page, timeout=30.0) as client:
            yield running, client
    finally:
        if running.poll() is None:
            running.terminate()
        running.stdout.close()
        running.wait(20)
        log.close()


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
    wait_for(
        lambda: client.get(f"/api/v1/jobs/{job_id}").json()["health"]["samples"] > 500,
        "samples",
    )


def wait_for(reached, what, patience_s=90.0):
    """Wait for what may take minutes on a busy computer."""
    end = time.monotonic() + patience_s
    while not reached():
        assert time.monotonic() < end, f"waited in vain for {what}"
        time.sleep(0.1)


def wait_until_done(client, job_id, number, kind="measure-otf"):
    unit = "points" if kind == "measure-standstill" else "lines"

    def is_done():
        job = client.get(f"/api/v1/jobs/{job_id}").json()
        assert job["state"] not in ENDS, job
        progress = job["progress"]
        return progress["unit"] == unit and progress["done"] >= number

    wait_for(is_done, "the first lines")


def kill(service):
    """End the service as kill -9 does, and wait until nothing of it is left."""
    children = psutil.Process(service.pid).children(recursive=True)
    service.kill()
    service.wait(10)
    psutil.wait_procs(children, timeout=20)
