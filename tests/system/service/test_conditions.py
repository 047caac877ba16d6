"""Conditions over REST: on the real service, with devices that a test works."""

import socket
import time

import pytest

from api_builders import arm_over_http
from real_services import environment_of, process
from service_process import ROWS, arm, create, follow, wait_for
from truepath_simulators.bench.rig import running_rig

AT = "/api/v1/machines/current/conditions"
GETS = 20
QUICK_S = 0.25  # on the mean; a device that held them took 6.5 s of each


def levels(client):
    items = client.get(AT).json()["items"]
    return {item["type"]: item["level"] for item in items}


def is_connecting(client):
    return client.get("/api/v1/system").json()["cell"]["state"] == "connecting"


@pytest.mark.long
@pytest.mark.fault_row(19)
def test_a_job_is_not_armed_while_a_door_is_open(tmp_path):
    with running_rig({"speed": 12.0, "tracker": "tcp"}) as rig:
        file = tmp_path / "machine.json"
        environment = environment_of(rig.motion_options, rig.tracker_options, file)
        with process(tmp_path, **environment) as (_, client):
            assert levels(client)["devices-connected"] == "false"
            job = create(client, path=ROWS[:3])
            rig.inject("cnc:door@0s+180s")  # of the machine: 15 s
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
            beam = "target-in-sight"
            wait_for(lambda: levels(client)[beam] == "true", "the beam")
            rig.inject("tracker:beam-break@0s+240s")  # of the machine: 20 s
            wait_for(lambda: levels(client)[beam] == "false", "the broken beam")
            assert arm_over_http(client, job).json()["conditions"] == [beam]
            wait_for(lambda: levels(client)[beam] == "true", "the beam again")
            assert rig.read_position()["position"] == before
            arm(client, job)
            wait_for(lambda: rig.read_position()["position"] != before, "motion")
            client.post("/api/v1/stop")
            follow(client, job["id"], "aborted")


@pytest.mark.fault_row(16)
def test_a_device_that_swallows_everything_delays_no_request(tmp_path):
    with socket.create_server(("127.0.0.1", 0), backlog=8) as hole:
        place = {"host": "127.0.0.1", "port": hole.getsockname()[1]}
        file = tmp_path / "machine.json"
        environment = environment_of(place | {"unit": 1}, place, file)
        order = {"kind": "measure-otf", "path": ROWS}
        with process(tmp_path, **environment) as (_, client):
            job = client.post("/api/v1/jobs", json=order).json()
            wait_for(lambda: is_connecting(client), "a cell that connects")
            begun_s = time.monotonic()
            for n in range(GETS):
                path = ("/api/v1/system", AT, f"/api/v1/jobs/{job['id']}")[n % 3]
                assert client.get(path).status_code == 200
            assert time.monotonic() - begun_s < GETS * QUICK_S
            assert client.post("/api/v1/stop").status_code == 202
