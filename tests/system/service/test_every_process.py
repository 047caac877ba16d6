"""Processes of the service stand still or are killed, in every state and at any moment.

Whatever happens: the service answers, nothing that it has answered is lost or doubled,
no job is active for ever, what failed says why, a machine whose service has died stands
still, and nothing moves before it is armed anew.
"""

import itertools
import random
import time
from contextlib import suppress
from dataclasses import dataclass, field

import httpx2
import psutil
import pytest

from api_builders import arm_over_http
from processes import runs
from real_services import environment_of, find_child, process
from service_process import ENDS, ROWS, arm, begin_moving, create, follow, wait_for
from service_with_devices import connect, moves, running_devices

pytestmark = [pytest.mark.long, pytest.mark.timeout(900)]
OURS = ("worker", "live", "cell")
DEVICES = ("cnc", "tracker")
FROZEN_S = 3.0
BEGIN_S = 30.0  # for a process that has to come
HARMS = 40
STANDS_S = 5.0
"""Watchdog of the simulated controller, its ramp, and a busy computer."""
SETTLED = ENDS | {"paused", "ready"}  # nothing moves, or somebody has to say so


def has_to_run(role, state):
    """Whether it is there then: a worker is once it was needed."""
    is_under_way = state in ("running", "paused")
    return role in ("cell", *DEVICES) or (role == "live" and is_under_way)


def state_of(client, job):
    return client.get(f"/api/v1/jobs/{job}").json()


def make_ready(client):
    return create(client, path=ROWS)["id"]


def make_paused(client):
    job = begin_moving(client)
    client.post(f"/api/v1/jobs/{job}/pause")
    follow(client, job, "paused")
    return job


def make_computing(client):
    job = create(client, path=ROWS[:6])
    arm(client, job)
    stages = {"aligning", "estimating", "reporting"}
    wait_for(lambda: state_of(client, job["id"])["stage"] in stages, "computing")
    return job["id"]


STATES = {"ready": make_ready, "running": begin_moving}
STATES |= {"paused": make_paused, "computing": make_computing}


def harm(found, is_kill, frozen_s=FROZEN_S):
    with suppress(psutil.NoSuchProcess):  # it may have ended by itself
        if is_kill:
            found.kill()
            return
        found.suspend()
        time.sleep(frozen_s)  # what is tested is that time passes
        found.resume()


def settle(client, job):
    wait_for(lambda: state_of(client, job)["state"] in SETTLED, "a settled job")
    return state_of(client, job)["state"]


def current_job(client):
    return client.get("/api/v1/system").json()["current_job"]


def stop(client):
    assert client.post("/api/v1/stop").status_code == 202
    wait_for(lambda: current_job(client) is None, "the end of the job")


def require_in_order(client, job):
    """Nothing moves after a stop; what failed says why; the service is there."""
    settle(client, job)
    stop(client)
    wait_for(lambda: state_of(client, job)["state"] in ENDS, "its end")
    ended = state_of(client, job)
    if ended["state"] in ("failed", "faulted"):
        assert ended["error"]["title"] != "The service failed"
        assert ended["error"]["action"]
    if ended["run_id"]:
        assert client.get(f"/api/v1/runs/{ended['run_id']}").json()["samples"] >= 0


def harm_each(running, client, state, roles):
    """Freeze and kill each process in a state of a job; return which were there.

    A job that stands as before is harmed on, unless it has lost its cell.
    """
    job, harmed = None, set()
    harms = list(itertools.product(roles, (False, True)))
    for role, is_kill in harms:
        if job is None:
            connect(client)
            job = STATES[state](client)
        patience_s = BEGIN_S if has_to_run(role, state) else 0.3
        found, end_s = None, time.monotonic() + patience_s
        while found is None and time.monotonic() < end_s:
            found = find_child(running.pid, role)
            time.sleep(0.05)
        if found is not None:
            harm(found, is_kill)
            harmed.add(role)
        stands = settle(client, job) == state and role != "cell"
        if not stands or (role, is_kill) == harms[-1]:
            require_in_order(client, job)
            job = None
    return harmed


@pytest.mark.fault_row(30)
@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("roles", [OURS, ("cnc",), ("tracker",)], ids="-".join)
def test_no_process_that_stands_or_dies_leaves_a_motion(tmp_path, roles, state):
    with process(tmp_path) as opened:
        harmed = harm_each(*opened, state, roles)
    assert {role for role in roles if has_to_run(role, state)} <= harmed


@pytest.mark.fault_row(25)
def test_a_service_that_dies_in_any_state_is_interrupted_and_begins_anew(tmp_path):
    job = None
    for state in (*STATES.values(), None):
        with process(tmp_path) as (running, client):
            if job is not None:
                # The job has ended, and another can be made.
                wait_for(
                    lambda job=job: state_of(client, job)["state"] in ENDS, "its end"
                )
                assert state_of(client, job)["state"] in ("interrupted", "succeeded")
                assert current_job(client) is None
                connect(client)
                again = make_ready(client)
                client.post(f"/api/v1/jobs/{again}/abort")
                follow(client, again, "aborted")
            if state is not None:
                job = state(client)
                running.kill()
                running.wait(10)


@dataclass
class Ledger:
    """What the service has answered: version of each job, number of kept events."""

    versions: dict[str, int] = field(default_factory=dict)
    events: int = 0

    def note(self, *jobs):
        self.versions |= {job["id"]: job["version"] for job in jobs}

    def require_kept(self, client):
        """Whatever was answered is there, as it was or later, once, and has ended.

        Every Run can be read. Nothing is under way, no device was opened again.
        """
        jobs = {job["id"]: job for job in list_jobs(client)}
        assert set(self.versions) <= set(jobs)
        for job_id, version in self.versions.items():
            assert jobs[job_id]["version"] >= version
            assert jobs[job_id]["state"] in ENDS
        for job in jobs.values():
            if job["run_id"]:
                run = client.get(f"/api/v1/runs/{job['run_id']}").json()
                assert run["samples"] >= 0
        system = client.get("/api/v1/system").json()
        assert system["current_job"] is None
        assert system["cell"]["connected"] is False
        ids = list_event_ids(client)
        assert ids == list(range(1, len(ids) + 1))
        assert len(ids) >= self.events
        self.events = len(ids)


def list_event_ids(client):
    ids = []
    with client.stream("GET", "/api/v1/events", headers={"Last-Event-ID": "0"}) as got:
        for line in got.iter_lines():
            if line.startswith("id: "):
                ids.append(int(line[4:]))
            if line.startswith("event: tick"):
                break
    return ids


def list_jobs(client):
    page = client.get("/api/v1/jobs?limit=200").json()
    assert page["next"] is None
    return page["items"]


@pytest.fixture
def rig():
    """Devices that are no children of the service: they go on when it dies."""
    with running_devices(speed=12.0) as started:
        yield started


@pytest.mark.fault_row(25)
@pytest.mark.fault_row(23)
def test_nothing_is_lost_or_moves_after_kills_and_freezes(tmp_path, rig, measured):
    rng, ledger = random.Random(1), Ledger()
    file = tmp_path / "machine.json"
    environment = environment_of(rig.motion_options, rig.tracker_options, file)
    done, kills = 0, 0
    while True:
        with process(tmp_path, **environment) as (running, client):
            # The machine comes to rest by itself and stays there.
            wait_for(lambda: not moves(rig), "a machine that stands still", STANDS_S)
            assert not moves(rig)
            ledger.require_kept(client)
            if done == HARMS:  # the last service is only looked at
                break
            while done < HARMS and running.poll() is None:
                done += 1
                kills += harm_once(rng, running, client, ledger)
    assert kills > 0.4 * HARMS
    measured(f"{kills} kills and {done - kills} freezes, nothing lost, nothing moved")


def harm_once(rng, running, client, ledger):
    """Work for a while, harm a process, bring all in order; say whether it was killed.

    A service that was killed stays dead: the caller starts it anew.
    """
    end_s = time.monotonic() + rng.uniform(0.0, 1.5)
    with suppress(httpx2.HTTPError):
        work(client, ledger, end_s)
    role = rng.choice(("service", "cell", "live", "worker"))
    found = find_child(running.pid, role) or psutil.Process(running.pid)
    is_kill = rng.random() < 0.7
    if is_kill and found.pid == running.pid:
        children = [child.pid for child in found.children(recursive=True)]
        found.kill()
        running.wait(10)
        wait_for(lambda: not any(map(runs, children)), "the end of all of it", 20.0)
        return True
    harm(found, is_kill, rng.uniform(0.1, 1.5))
    if rng.random() < 0.2:
        for job in list_jobs(client):
            settle(client, job["id"])
    stop(client)
    ledger.note(*list_jobs(client))
    return is_kill


def work(client, ledger, end_s):
    client.post("/api/v1/machines/current:connect")
    answer = client.post("/api/v1/jobs", json={"kind": "measure-otf", "path": ROWS})
    if answer.status_code != 202:  # a cell that begins anew
        return
    job, armed = answer.json(), False
    ledger.note(job)
    while time.monotonic() < end_s:
        job = state_of(client, job["id"])
        ledger.note(job)
        if job["state"] == "ready" and not armed:
            armed = arm_over_http(client, job).status_code == 202
        time.sleep(0.01)
