"""Every process of the service stands still or is killed, in every state of a job.

Whatever happens: the service answers, no job is active for ever, what failed says why,
and after a stop nothing is left that moves.
"""

from __future__ import annotations

import itertools
import os
import signal
import time
from collections.abc import Callable

import httpx2
import pytest

from real_services import find_child, process
from service_process import ENDS, ROWS, arm, create, follow, moving, wait_for

pytestmark = [pytest.mark.long, pytest.mark.timeout(600)]

OURS = ("worker", "live", "cell")
DEVICES = ("cnc", "tracker")
FROZEN_S = 3.0
BEGIN_S = 30.0  # for a process that has to come
SETTLED = ENDS | {"paused", "ready"}  # nothing moves, or somebody has to say so


def find_process(parent: int, role: str, patience_s: float = BEGIN_S) -> int | None:
    """Return the process with this part in the service, if it runs or begins to."""
    found, end_s = None, time.monotonic() + patience_s
    while found is None and time.monotonic() < end_s:
        found = find_child(parent, role)
        time.sleep(0.05)
    return None if found is None else found.pid


def has_to_run(role: str, state: str) -> bool:
    """Whether it is there then: a live estimator of a machine under way.

    A worker is there once it was needed.
    """
    return role in ("cell", *DEVICES) or (
        role == "live" and state in ("running", "paused")
    )


def state_of(client: httpx2.Client, job: str) -> dict:
    return client.get(f"/api/v1/jobs/{job}").json()


def make_ready(client: httpx2.Client) -> str:
    return create(client, path=ROWS)["id"]


def make_moving(client: httpx2.Client) -> str:
    job = create(client, path=ROWS)
    arm(client, job)
    moving(client, job["id"])
    return job["id"]


def make_paused(client: httpx2.Client) -> str:
    job = make_moving(client)
    client.post(f"/api/v1/jobs/{job}/pause")
    follow(client, job, "paused")
    return job


def make_computing(client: httpx2.Client) -> str:
    job = create(client, path=ROWS[:6])
    arm(client, job)
    stages = {"aligning", "estimating", "reporting"}
    wait_for(lambda: state_of(client, job["id"])["stage"] in stages, "computing")
    return job["id"]


STATES: dict[str, Callable[[httpx2.Client], str]] = {
    "ready": make_ready,
    "running": make_moving,
    "paused": make_paused,
    "computing": make_computing,
}


def harm(process_id: int, number: signal.Signals) -> None:
    """Kill a process, or let it stand still for a while."""
    os.kill(process_id, number)
    if number is signal.SIGSTOP:
        time.sleep(FROZEN_S)  # what is tested is that time passes
        os.kill(process_id, signal.SIGCONT)


def settle(client: httpx2.Client, job: str) -> str:
    """Wait until the job has ended, waits for somebody, or has gone on to its end."""
    wait_for(lambda: state_of(client, job)["state"] in SETTLED, "a settled job")
    return state_of(client, job)["state"]


def require_in_order(client: httpx2.Client, job: str) -> None:
    """Nothing moves after a stop; what failed says why; the service is there."""
    settle(client, job)
    assert client.post("/api/v1/stop").status_code == 202
    wait_for(lambda: state_of(client, job)["state"] in ENDS, "its end")
    ended = state_of(client, job)
    if ended["state"] in ("failed", "faulted"):
        assert ended["error"]["title"] != "The service failed"
        assert ended["error"]["action"]
    if ended["run_id"]:
        assert client.get(f"/api/v1/runs/{ended['run_id']}").json()["samples"] >= 0
    system = client.get("/api/v1/system").json()
    assert system["current_job"] is None


def require_anew(client: httpx2.Client, job: str) -> None:
    """The job of a service that died has ended, and another can be made."""
    wait_for(lambda: state_of(client, job)["state"] in ENDS, "its end")
    assert state_of(client, job)["state"] in ("interrupted", "succeeded")
    assert client.get("/api/v1/system").json()["current_job"] is None
    connect(client)
    again = make_ready(client)
    client.post(f"/api/v1/jobs/{again}/abort")
    follow(client, again, "aborted")


def connect(client: httpx2.Client) -> None:
    wait_for(
        lambda: client.post("/api/v1/machines/current:connect").status_code == 200,
        "the devices",
    )


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    """A real service that every test leaves in order, and a client of it."""
    with process(tmp_path_factory.mktemp("service")) as opened:
        yield opened


def harm_each(running, client, state: str, roles: tuple[str, ...]) -> set[str]:
    """Freeze and kill each process in a state of a job; return which were there.

    A job that stands as before is harmed on, unless it has lost its cell.
    """
    job, harmed = None, set[str]()
    harms = list(itertools.product(roles, (signal.SIGSTOP, signal.SIGKILL)))
    for role, number in harms:
        if job is None:
            connect(client)
            job = STATES[state](client)
        patience_s = BEGIN_S if has_to_run(role, state) else 0.3
        found = find_process(running.pid, role, patience_s)
        if found is not None:
            harm(found, number)
            harmed.add(role)
        stands = settle(client, job) == state and role != "cell"
        if not stands or (role, number) == harms[-1]:
            require_in_order(client, job)
            job = None
    return harmed


@pytest.mark.fault_row(30)
@pytest.mark.parametrize("state", STATES)
def test_no_process_of_ours_that_stands_or_dies_leaves_a_job_or_a_motion(
    service, state
):
    harmed = harm_each(*service, state, OURS)
    assert {role for role in OURS if has_to_run(role, state)} <= harmed


@pytest.mark.fault_row(30)
@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("device", DEVICES)
def test_no_device_that_stands_or_dies_does(tmp_path, state, device):
    with process(tmp_path) as opened:
        assert harm_each(*opened, state, (device,))


@pytest.mark.fault_row(25)
def test_a_service_that_dies_in_any_state_is_interrupted_and_begins_anew(tmp_path):
    job = None
    for state in (*STATES.values(), None):
        with process(tmp_path) as (running, client):
            if job is not None:
                require_anew(client, job)
            if state is not None:
                job = state(client)
                running.kill()
                running.wait(10)
