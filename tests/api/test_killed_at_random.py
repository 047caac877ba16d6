"""The service killed at any moment: nothing it has answered is lost, nothing moves."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from contextlib import suppress

import httpx2
import psutil
import pytest

ROUNDS = 12
ENDS = {"succeeded", "failed", "faulted", "aborted", "interrupted"}
PROGRAM = """
from truepath.app.main import serve
from truepath.app.settings import load_settings

if __name__ == "__main__":
    serve(load_settings())
"""
ROWS = [
    {"x_mm": 20 + 440 * (n % 2), "y_mm": 20 + 30 * n, "z_mm": 20 + 20 * n}
    for n in range(12)
]


@pytest.fixture
def start(tmp_path):
    """Start the service on one data folder, again and again."""
    program = tmp_path / "service.py"
    program.write_text(PROGRAM)
    environment = os.environ | {
        "TRUEPATH_DATA_DIR": str(tmp_path / "data"),
        "TRUEPATH_PORT": "0",
        "TRUEPATH_SIMULATED": "1",
        "TRUEPATH_SIMULATED_SPEED": "12",
    }
    started = []

    def run():
        log = (tmp_path / "service.log").open("a")
        service = subprocess.Popen(
            [sys.executable, program],
            stdout=subprocess.PIPE,
            stderr=log,
            text=True,
            env=environment,
        )
        log.close()
        started.append(service)
        lines = [service.stdout.readline() for _ in range(4)]
        address = next(x.split()[1] for x in lines if x.split()[:1] == ["page"])
        return service, httpx2.Client(base_url=address, timeout=20)

    yield run
    for service in started:
        if service.poll() is None:
            service.terminate()
        service.wait(20)
        service.stdout.close()


@pytest.mark.long
@pytest.mark.timeout(600)
@pytest.mark.fault_row(25)
def test_whatever_was_answered_is_there_after_a_kill_at_any_moment(start):
    rng = random.Random(11)
    known: dict[str, int] = {}
    last_event = 0
    for _ in range(ROUNDS):
        service, client = start()
        with client:
            last_event = look(client, known, last_event)
            end = time.monotonic() + rng.uniform(0.0, 4.0)
            with suppress(httpx2.HTTPError):
                work(client, known, end)
            children = psutil.Process(service.pid).children(recursive=True)
            service.send_signal(signal.SIGKILL)
            service.wait(10)
            _, alive = psutil.wait_procs(children, timeout=20)
            assert not alive, alive
    service, client = start()
    with client:
        look(client, known, last_event)


def look(client, known, last_event):
    """Check what a restarted service says of the jobs it had answered for."""
    jobs = {}
    after = ""
    while after is not None:
        page = client.get(f"/api/v1/jobs?limit=3{after and f'&after={after}'}").json()
        jobs |= {job["id"]: job for job in page["items"]}
        after = page["next"]
    assert set(known) <= set(jobs)
    for job_id, version in known.items():
        assert jobs[job_id]["version"] >= version
        assert jobs[job_id]["state"] in ENDS
    system = client.get("/api/v1/system").json()
    assert system["current_job"] is None
    assert system["cell"]["connected"] is False
    with client.stream("GET", "/api/v1/events", headers={"Last-Event-ID": "0"}) as got:
        ids = []
        for line in got.iter_lines():
            if line.startswith("id: "):
                ids.append(int(line[4:]))
            if line.startswith("event: tick"):
                break
    assert ids == list(range(1, len(ids) + 1))
    assert len(ids) >= last_event
    return len(ids)


def work(client, known, end):
    """Measure until it is time to be killed; note what was answered."""
    job = client.post("/api/v1/jobs", json={"kind": "measure-otf", "path": ROWS}).json()
    known[job["id"]] = job["version"]
    address = f"/api/v1/jobs/{job['id']}"
    armed = False
    while time.monotonic() < end:
        job = client.get(address).json()
        known[job["id"]] = job["version"]
        if job["state"] == "ready" and not armed:
            version = {"If-Match": f'"{job["version"]}"'}
            answer = client.post(f"{address}/arm", headers=version)
            armed = answer.status_code == 202
        time.sleep(0.01)
