"""Any process killed or stopped at any moment, again and again, on one data folder.

The devices are no children of the service: they go on when it dies, and tell where the
machine truly is. Whatever happens: nothing that the service has answered is lost or
doubled, a machine whose service has died stands still, and nothing moves before it is
armed anew.
"""

from __future__ import annotations

import random
import time
from contextlib import suppress
from dataclasses import dataclass, field

import httpx2
import psutil
import pytest

from arming import arm_over_http
from real_services import environment_of, find_child, process
from service_process import ENDS, SPEED, wait_for
from truepath_simulators.bench.rig import Rig, running_rig

HARMS = 40
KILLED_SHARE = 0.7
SETTLED_SHARE = 0.2
LONGEST_WORK_S = 1.5
LONGEST_FREEZE_S = 1.5
STANDS_S = 5.0
"""Watchdog of the simulated controller, its ramp, and a busy computer."""
REST_S = 0.25
MOVED_MM = 1e-6
ROLES = ("service", "cell", "live", "worker")
SETTLED = ENDS | {"paused", "ready"}
ROWS = [
    {"x_mm": 20 + 440 * (n % 2), "y_mm": 20 + 30 * n, "z_mm": 20 + 20 * n}
    for n in range(12)
]


@dataclass
class Ledger:
    """What the service has answered: version of each job, number of kept events."""

    versions: dict[str, int] = field(default_factory=dict)
    events: int = 0

    def note(self, job: dict) -> None:
        self.versions[job["id"]] = job["version"]


@pytest.fixture
def rig():
    with running_rig({"speed": SPEED, "tracker": "tcp", "seed": 3}) as started:
        yield started


@pytest.mark.long
@pytest.mark.timeout(900)
@pytest.mark.fault_row(25)
@pytest.mark.fault_row(23)
def test_nothing_answered_is_lost_and_nothing_moves_after_kills_and_freezes(
    tmp_path, rig, measured
):
    rng, ledger = random.Random(1), Ledger()
    file = tmp_path / "machine.json"
    environment = environment_of(rig.motion_options, rig.tracker_options, file)
    done, kills = 0, 0
    while done < HARMS:
        with process(tmp_path, **environment) as (service, client):
            require_standstill(rig)
            require_kept(client, ledger)
            while done < HARMS and service.poll() is None:
                done += 1
                kills += harm_once(rng, service, client, ledger)
    with process(tmp_path, **environment) as (_, client):
        require_standstill(rig)
        require_kept(client, ledger)
        require_readable_runs(client, ledger)
    assert kills > 0.4 * HARMS
    measured(f"{kills} kills and {done - kills} freezes, nothing lost, nothing moved")


def harm_once(rng, service, client, ledger) -> bool:
    """Work for a while, harm a process, bring all in order; say whether it was killed.

    A service that was killed stays dead: the caller starts it anew.
    """
    end_s = time.monotonic() + rng.uniform(0.0, LONGEST_WORK_S)
    with suppress(httpx2.HTTPError):
        work(client, ledger, end_s)
    found = find_child(service.pid, rng.choice(ROLES)) or psutil.Process(service.pid)
    is_kill = rng.random() < KILLED_SHARE
    if is_kill and found.pid == service.pid:
        children = found.children(recursive=True)
        found.kill()
        service.wait(10)
        _, left = psutil.wait_procs(children, timeout=20)
        alive = [one for one in left if not has_ended(one)]
        assert not alive, alive
        return True
    harm(found, is_kill, rng.uniform(0.1, LONGEST_FREEZE_S))
    if rng.random() < SETTLED_SHARE:
        settle(client)
    stop(client, ledger)
    return is_kill


def has_ended(process: psutil.Process) -> bool:
    """Say whether a process has ended, though nobody may have asked for its status."""
    try:
        return process.status() == psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return True


def harm(found: psutil.Process, is_kill: bool, frozen_s: float) -> None:
    """Kill a process, or let it stand still for a while."""
    with suppress(psutil.NoSuchProcess):  # it may have ended by itself
        if is_kill:
            found.kill()
            return
        found.suspend()
        time.sleep(frozen_s)  # what is tested is that time passes
        found.resume()


def settle(client) -> None:
    """Wait until no job does anything that somebody would have to wait for."""
    for job in list_jobs(client):
        address = f"/api/v1/jobs/{job['id']}"
        if job["state"] not in ENDS:
            wait_for(lambda a=address: client.get(a).json()["state"] in SETTLED, job)


def stop(client, ledger) -> None:
    """After a stop no job is active; note what was answered."""
    assert client.post("/api/v1/stop").status_code == 202
    wait_for(lambda: current_job(client) is None, "the end of the job")
    for job in list_jobs(client):
        ledger.note(job)


def current_job(client):
    return client.get("/api/v1/system").json()["current_job"]


def work(client, ledger, end_s) -> None:
    """Measure until it is time to be harmed; note what was answered."""
    client.post("/api/v1/machines/current:connect")
    answer = client.post("/api/v1/jobs", json={"kind": "measure-otf", "path": ROWS})
    if answer.status_code != 202:  # a cell that begins anew
        return
    job = answer.json()
    ledger.note(job)
    address, armed = f"/api/v1/jobs/{job['id']}", False
    while time.monotonic() < end_s:
        job = client.get(address).json()
        ledger.note(job)
        if job["state"] == "ready" and not armed:
            armed = arm_over_http(client, job).status_code == 202
        time.sleep(0.01)


def require_standstill(rig: Rig) -> None:
    """The machine comes to rest by itself and stays there."""

    def rests():
        before = rig.read_position()["position"][0]
        time.sleep(REST_S)
        after = rig.read_position()["position"][0]
        return max(abs(a - b) for a, b in zip(after, before, strict=True)) < MOVED_MM

    wait_for(rests, "a machine that stands still", STANDS_S)
    assert rests()


def require_kept(client, ledger) -> None:
    """Whatever was answered is there, in its last version or a later one, and ended."""
    jobs = {job["id"]: job for job in list_jobs(client)}
    assert set(ledger.versions) <= set(jobs)
    for job_id, version in ledger.versions.items():
        assert jobs[job_id]["version"] >= version
        assert jobs[job_id]["state"] in ENDS
    system = client.get("/api/v1/system").json()
    assert system["current_job"] is None
    assert system["cell"]["connected"] is False
    ids = list_event_ids(client)
    assert ids == list(range(1, len(ids) + 1))
    assert len(ids) >= ledger.events
    ledger.events = len(ids)


def list_event_ids(client) -> list[int]:
    """Return the numbers of all events that are kept."""
    ids: list[int] = []
    with client.stream("GET", "/api/v1/events", headers={"Last-Event-ID": "0"}) as got:
        for line in got.iter_lines():
            if line.startswith("id: "):
                ids.append(int(line[4:]))
            if line.startswith("event: tick"):
                break
    return ids


def list_jobs(client) -> list[dict]:
    """Return all jobs, page by page."""
    jobs, after = [], ""
    while after is not None:
        page = client.get(f"/api/v1/jobs?limit=50{after and f'&after={after}'}").json()
        jobs += page["items"]
        after = page["next"]
    return jobs


def require_readable_runs(client, ledger) -> None:
    """Every Run of a job can be taken away as a bundle, and has what it says."""
    for job in list_jobs(client):
        if job["run_id"]:
            run = client.get(f"/api/v1/runs/{job['run_id']}")
            assert run.status_code == 200, run.text
            assert run.json()["samples"] >= 0
