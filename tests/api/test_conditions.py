"""Conditions over REST: on the real service, with devices that a test works."""

from __future__ import annotations

import json
import socket
import time

import pytest
from arming import arm_over_http
from service_process import ROWS, arm, create, follow, process, wait_for

from truepath.simulators.rig import running_rig
from truepath.simulators.scenario import load_machine

AT = "/api/v1/machines/current/conditions"
GETS = 20
QUICK_S = 0.25  # on the mean; a device that held them took 6.5 s of each


@pytest.fixture
def machine_file(tmp_path):
    file = tmp_path / "machine.json"
    file.write_text(json.dumps(load_machine("demo")))
    return str(file)


def levels(client):
    items = client.get(AT).json()["items"]
    return {item["type"]: item["level"] for item in items}


def is_connecting(client):
    return client.get("/api/v1/system").json()["cell"]["state"] == "connecting"


@pytest.mark.long
@pytest.mark.fault_row(19)
def test_a_job_is_not_armed_while_a_door_is_open(tmp_path, machine_file):
    with running_rig({"speed": 12.0, "tracker": "tcp"}) as rig:
        environment = {
            "TRUEPATH_SIMULATED": "0",
            "TRUEPATH_MACHINE_FILE": machine_file,
            "TRUEPATH_TRACKER_OPTIONS": json.dumps(rig.tracker_options),
            "TRUEPATH_MOTION_OPTIONS": json.dumps(rig.motion_options),
        }
        with process(tmp_path, **environment) as (_, client):
            assert levels(client)["devices-connected"] == "false"
            job = create(client, path=ROWS[:3])
            rig.inject("cnc:door@0s+60s")  # of the machine: 5 s
            able = "controller-able"
            wait_for(lambda: levels(client)[able] == "false", "the open door")
            refused = arm_over_http(client, job)
            assert refused.status_code == 409
            assert refused.json()["code"] == "not-in-order"
            assert refused.json()["conditions"] == [able]
            assert "door" in refused.json()["detail"]
            assert follow(client, job["id"], "ready")["version"] == job["version"]
            before = rig.read_position()["position"]
            wait_for(lambda: levels(client)[able] == "true", "the door to be shut")
            assert rig.read_position()["position"] == before
            arm(client, job)
            wait_for(lambda: rig.read_position()["position"] != before, "motion")
            client.post("/api/v1/stop")
            follow(client, job["id"], "aborted")


@pytest.mark.fault_row(16)
def test_a_device_that_swallows_everything_delays_no_request(tmp_path, machine_file):
    with socket.create_server(("127.0.0.1", 0), backlog=8) as hole:
        place = {"host": "127.0.0.1", "port": hole.getsockname()[1]}
        environment = {
            "TRUEPATH_SIMULATED": "0",
            "TRUEPATH_MACHINE_FILE": machine_file,
            "TRUEPATH_TRACKER_OPTIONS": json.dumps(place),
            "TRUEPATH_MOTION_OPTIONS": json.dumps(place | {"unit": 1}),
        }
        with process(tmp_path, **environment) as (_, client):
            job = client.post(
                "/api/v1/jobs", json={"kind": "measure-otf", "path": ROWS}
            ).json()
            wait_for(lambda: is_connecting(client), "a cell that connects")
            begun_s = time.monotonic()
            for n in range(GETS):
                path = ("/api/v1/system", AT, f"/api/v1/jobs/{job['id']}")[n % 3]
                assert client.get(path).status_code == 200
            assert time.monotonic() - begun_s < GETS * QUICK_S
            assert client.post("/api/v1/stop").status_code == 202
