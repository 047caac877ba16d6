"""The tracker is moved between stations: the service over simulated devices."""

from __future__ import annotations

import json
import time
from contextlib import contextmanager

import numpy as np
import pytest
from starlette.testclient import TestClient

from arming import arm_over_http
from truepath.main import open_service
from truepath.service.api.application import create_application
from truepath.settings import load_settings
from truepath_simulators.bench.bench import Bench

SPEED = 12.0
WORKSPACE = {
    "tracker": {
        "areas": [
            {"min_mm": [-900, -900, 0], "max_mm": [1400, -500, 100]},
            {"min_mm": [900, -900, 0], "max_mm": [1400, 900, 100]},
        ],
        "nearest_mm": 300,
        "move_minutes": 3,
    }
}
ENDS = {"succeeded", "failed", "faulted", "aborted", "interrupted"}

# Half a minute, but three programs beside it.
pytestmark = [pytest.mark.long, pytest.mark.timeout(300)]


@pytest.fixture
def bench(tmp_path):
    with Bench(seed=3, speed=SPEED, workdir=tmp_path / "links") as running:
        yield running


@pytest.fixture
def open_client(bench, tmp_path):
    """Opens the service on the bench, as often as the test wants."""
    file = tmp_path / "machine.json"
    file.write_text(json.dumps(bench.machine))
    settings = load_settings(
        data_dir=tmp_path / "data",
        machine_file=file,
        tracker_options=bench.tracker_options,
        motion_options=bench.motion_options,
        port=0,
    )

    @contextmanager
    def opened():
        with (
            open_service(settings) as service,
            TestClient(
                create_application(service), base_url="http://localhost"
            ) as client,
        ):
            yield client

    return opened


def wait_until(reached, what):
    """Return what `reached` gives once it is true; plans take a while."""
    end = time.monotonic() + 120.0
    while not (found := reached()):
        assert time.monotonic() < end, f"waited in vain for {what}"
        time.sleep(0.05)
    return found


def follow(client, job_id, *states):
    """Wait until a job is in a state that it reaches on its way."""

    def reached():
        job = client.get(f"/api/v1/jobs/{job_id}").json()
        assert job["state"] in states or job["state"] not in ENDS, job["error"]
        return job if job["state"] in states else None

    return wait_until(reached, states)


def plan(client, **more):
    order = {"mode": "otf", "minutes": 1.0, "workspace": WORKSPACE, **more}
    made = client.post("/api/v1/plans", json=order)
    assert made.status_code == 202, made.text
    address = f"/api/v1/plans/{made.json()['id']}"
    return wait_until(
        lambda: (p := client.get(address).json())["state"] in ENDS and p, "the plan"
    )


def begin(client, planned):
    """Make the job of a plan and wait until it is ready."""
    order = {"kind": "measure-otf", "plan_id": planned["id"]}
    made = client.post("/api/v1/jobs", json=order)
    assert made.status_code == 202, made.text
    return follow(client, made.json()["id"], "ready")


def arm(client, job):
    answer = arm_over_http(client, job)
    assert answer.status_code == 202, answer.text
    assert answer.json()["state"] == "running"


def set_down(bench, job, number):
    """Carry the tracker to where the job asks for it, as well as people can."""
    place = np.add(job["station"]["position_mm"], [20.0, -15.0, 5.0])
    bench.move_tracker(place, number)


def test_a_machine_is_measured_from_two_stations(bench, open_client):
    with open_client() as client:
        planned = plan(client, stations=2)
        assert planned["state"] == "succeeded", planned["error"]
        places = [s["position_mm"] for s in planned["document"]["at_stations"]]
        job = begin(client, planned)
        assert job["station"]["position_mm"] == pytest.approx(places[0], abs=0.1)
        set_down(bench, job, 1)
        arm(client, job)

        asked = follow(client, job["id"], "awaiting-move")
        assert asked["station"]["number"] == 2
        assert asked["station"]["position_mm"] == pytest.approx(places[1], abs=0.1)
        assert [c["problem"] for c in asked["station"]["checks"]] == [""]
        first_run = asked["run_id"]
        assert client.get(f"/api/v1/runs/{first_run}").json()["complete"]

        arm(client, asked)  # nobody has moved it
        again = follow(client, job["id"], "awaiting-move")
        assert again["station"]["checks"][-1]["problem"] == "not-moved"

        set_down(bench, job=again, number=2)
        arm(client, again)
        done = follow(client, job["id"], "succeeded")
        check = done["station"]["checks"][-1]
        assert (check["station"], check["problem"]) == (2, "")
        assert check["place_mm"] == pytest.approx(places[1], abs=30.0)
        assert check["residual_um"] < check["allowed_um"]
        assert done["run_ids"][0] == first_run
        assert len(done["run_ids"]) == 2

        result = client.get(done["result"]["result"]).json()
        print(result["verdict"])
        left = result["volumetric_uncertainty_um"]
        for run, place in zip(result["runs"], places, strict=True):
            assert run["tracker_mm"] == pytest.approx(place, abs=30.0)
            assert run["without_it_um"] > left


def test_a_service_restarted_while_it_waits_goes_on_with_what_is_recorded(
    bench, open_client
):
    with open_client() as client:
        job = begin(client, plan(client, stations=2))
        set_down(bench, job, 1)
        arm(client, job)
        asked = follow(client, job["id"], "awaiting-move")
        set_down(bench, asked, 2)
    with open_client() as client:
        ended = client.get(f"/api/v1/jobs/{job['id']}").json()
        assert ended["state"] == "interrupted"
        assert ended["run_ids"] == asked["run_ids"]
        assert client.get(f"/api/v1/runs/{ended['run_id']}").json()["complete"]
        order = {"kind": "measure-otf", "continues": job["id"]}
        again = client.post("/api/v1/jobs", json=order).json()
        again = follow(client, again["id"], "ready")
        assert again["station"]["number"] == 2

        arm(client, again)
        bench.inject(f"tracker:beam-break+{8.0 * SPEED}s")  # known points are hidden
        asked = follow(client, again["id"], "awaiting-move")
        assert asked["station"]["checks"][-1]["problem"] == "not-seen"
        wait_until(lambda: try_again(client, again["id"]), "the beam")
        done = client.get(f"/api/v1/jobs/{again['id']}").json()
        assert done["run_ids"][0] == ended["run_id"]
        result = client.get(done["result"]["result"]).json()
        assert len(result["runs"]) == 2


def try_again(client, job_id):
    """Arm a job where it asks for the tracker; tell whether it has succeeded."""
    job = client.get(f"/api/v1/jobs/{job_id}").json()
    assert job["state"] == "succeeded" or job["state"] not in ENDS, job["error"]
    if job["state"] == "awaiting-move":
        answer = arm_over_http(client, job)
        if answer.status_code != 202:  # the beam is not back yet
            assert answer.json()["conditions"] == ["target-in-sight"]
    return job["state"] == "succeeded"
