"""A service that is killed in motion, started again, and goes on where it stopped.

The devices are no children of the service: they go on when it dies, so that a reflector
can be knocked while nobody looks.
"""

from __future__ import annotations

import json
import random

import psutil
import pytest
from service_process import acknowledge, arm, create, follow, process, wait_for

from truepath.simulators.rig import running_rig
from truepath.simulators.scenario import load_machine

SPEED = 12.0
DONE = 6  # of the lines, when the service is killed
KNOCK_MM = 0.05
RNG = random.Random(1)
ROWS = [
    {
        "x_mm": round(RNG.uniform(10, 490), 1),
        "y_mm": round(RNG.uniform(10, 390), 1),
        "z_mm": round(RNG.uniform(10, 290), 1),
        "dwell_s": 0.6,
    }
    for _ in range(24)
]


@pytest.fixture
def rig():
    with running_rig({"speed": SPEED, "tracker": "tcp", "seed": 3}) as started:
        yield started


@pytest.fixture
def start(tmp_path, rig):
    """Starts the service on the devices of the rig, again and again on one folder."""
    machine = tmp_path / "machine.json"
    machine.write_text(json.dumps(load_machine("demo")))
    environment = {
        "TRUEPATH_SIMULATED": "0",
        "TRUEPATH_MACHINE_FILE": str(machine),
        "TRUEPATH_TRACKER_OPTIONS": json.dumps(rig.tracker_options),
        "TRUEPATH_MOTION_OPTIONS": json.dumps(rig.motion_options),
    }
    return lambda: process(tmp_path, **environment)


def kill_in_motion(start, **order):
    """Measure until some lines are done, then kill the service; return the job."""
    with start() as (service, client):
        job = create(client, **order)
        arm(client, job)
        wait_for(
            lambda: (
                client.get(f"/api/v1/jobs/{job['id']}").json()["progress"]["done"]
                >= DONE
            ),
            "the first lines",
        )
        children = psutil.Process(service.pid).children(recursive=True)
        service.kill()
        service.wait(10)
        psutil.wait_procs(children, timeout=20)
    return job["id"]


def stands(rig):
    before = rig.read_position()["position"]
    return rig.read_position()["position"] == before


@pytest.mark.fault_row(25)
@pytest.mark.fault_row(9)
@pytest.mark.timeout(240)
@pytest.mark.parametrize(
    "kind",
    ["measure-otf", pytest.param("measure-standstill", marks=pytest.mark.long)],
)
def test_a_measurement_whose_service_was_killed_goes_on_where_it_was(start, rig, kind):
    rows = "path" if kind == "measure-otf" else "points"
    job_id = kill_in_motion(start, **{"kind": kind, rows: ROWS})
    with start() as (_, client):
        job = client.get(f"/api/v1/jobs/{job_id}").json()
        assert job["state"] == "interrupted"
        before = rig.read_position()["position"]
        again = acknowledge(client, job_id)
        assert again["error"] is None
        going_on = client.get(f"/api/v1/jobs/{job_id}/plan").json()["resumption"]
        assert DONE - 1 <= going_on["first_row"] <= DONE + 4
        assert rig.read_position()["position"] == before, "it moved unarmed"
        arm(client, again)
        ended = follow(client, job_id, "succeeded")
        first, second = ended["run_ids"]
        assert first == job_id
        runs = [client.get(f"/api/v1/runs/{i}").json() for i in (first, second)]
        assert [run["complete"] for run in runs] == [False, True]
        result = client.get(f"/api/v1/jobs/{job_id}/result").json()
        assert ended["verdict"] == "usable", result["verdict"]
        assert len(result["runs"]) == 2


@pytest.mark.long
@pytest.mark.fault_row(11)
@pytest.mark.fault_row(25)
@pytest.mark.timeout(240)
def test_a_reflector_knocked_while_the_service_was_dead_is_refused_with_its_size(
    start, rig
):
    job_id = kill_in_motion(start, path=ROWS)
    rig.inject(f"tracker:knock@0s*{KNOCK_MM}")
    with start() as (_, client):
        arm(client, acknowledge(client, job_id))
        job = follow(client, job_id, "faulted")
        assert job["error"]["code"] == "closure"
        size_um = float(job["error"]["detail"].split()[3])
        assert size_um == pytest.approx(1e3 * KNOCK_MM, abs=15.0)
        assert "reflector" in job["error"]["action"]
        assert job["run_ids"] == [job_id]
        assert client.get(f"/api/v1/runs/{job_id}/bundle").status_code == 200
        assert acknowledge(client, job_id)["error"] is None
        client.post("/api/v1/stop")
