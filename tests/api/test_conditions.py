"""Conditions over REST: on the real service, with devices that a test works."""

from __future__ import annotations

import json
import socket
import time
from dataclasses import replace

import pytest
from arming import arm_over_http
from service_process import ROWS, arm, create, follow, process, wait_for

from truepath.machines.cell_status import CellStatus, ControllerLevels
from truepath.machines.conditions.condition_board import ConditionBoard
from truepath.machines.conditions.conditions import Finding, Level, Observed
from truepath.machines.conditions.stream_watch import StreamLevels
from truepath_drivers.interfaces.records import MotionState, MotionStatus
from truepath_simulators.bench.rig import running_rig
from truepath_simulators.scenario import load_machine

AT = "/api/v1/machines/current/conditions"
GETS = 20
QUICK_S = 0.25  # on the mean; a device that held them took 6.5 s of each


STATUS = MotionStatus(
    MotionState.IDLE, (0.0, 0.0, 0.0), 0, override=1.0, referenced=True
)
DEVICES = {"motion": {"has_watchdog": True}}
STREAM = StreamLevels(has_beam=True, lost_samples=0, crc_errors=0)
GOOD = Observed(
    CellStatus("ready", devices=DEVICES),
    ControllerLevels(STATUS, "", 0.0),
    allow_no_watchdog=False,
    free_bytes=10**9,
    least_bytes=10**8,
    stream=STREAM,
    drift_limit_degC=0.5,
)


def with_status(**change):
    return {"controller": ControllerLevels(replace(STATUS, **change), "", 0.0)}


def with_stream(**change):
    return {"stream": replace(STREAM, **change)}


WRONG = {
    "devices-connected": {"cell": CellStatus("down", "the port is gone")},
    "controller-answers": {"controller": ControllerLevels(None, "mute", 0.0)},
    "controller-able": with_status(state=MotionState.ALARM),
    "controller-free": with_status(state=MotionState.RUNNING),
    "axes-referenced": with_status(referenced=False),
    "compensation-as-asked": with_status(compensation=True),
    "feed-override-full": with_status(override=0.8),
    "watchdog-there": {"cell": CellStatus("ready", devices={"motion": {}})},
    "disk-has-room": {"free_bytes": 0},
    "target-in-sight": with_stream(has_beam=False),
    "stream-healthy": with_stream(failure="the tracker sends no samples"),
    "temperature-steady": with_stream(drift_degC=0.8, drifting="X_degC"),
}


@pytest.fixture
def seen():
    """What the board sees, as the only element."""
    return [GOOD]


@pytest.fixture
def board(seen, hand_clock):
    return ConditionBoard(lambda: seen[0])


def test_arming_is_refused_by_the_name_of_each_condition_that_is_wrong(
    client, seen, board
):
    asked = {"kind": "measure-otf", "control_compensation": "off"}
    job = client.post("/api/v1/jobs", json=asked).json()
    job = follow(client, job["id"], "ready")
    lying = board.path
    assert lying.level is Level.TRUE
    for kind, change in WRONG.items():
        seen[0] = replace(GOOD, **change)
        refused = arm_over_http(client, job)
        assert refused.status_code == 409, kind
        assert (refused.json()["code"], refused.json()["conditions"]) == (
            "not-in-order",
            [kind],
        )
    seen[0], board.path = GOOD, Finding(Level.FALSE, "keep-out", "it meets the vice")
    assert arm_over_http(client, job).json()["conditions"] == ["path-within-travel"]
    board.path = lying
    shown = client.post(f"/api/v1/jobs/{job['id']}/arming").json()
    required = {one["type"] for one in shown["conditions"] if one["is_required"]}
    assert required == {*WRONG, "path-within-travel"}
    assert arm_over_http(client, job).status_code == 202


@pytest.mark.parametrize(
    ("asked", "wants"),
    [({}, None), ({"control_compensation": "on"}, True)],
)
def test_a_job_that_waits_says_what_it_wants_of_the_control(
    client, board, asked, wants
):
    job = client.post("/api/v1/jobs", json={"kind": "measure-otf", **asked}).json()
    follow(client, job["id"], "ready")
    assert board.wants_compensation is wants
    client.post(f"/api/v1/jobs/{job['id']}/abort")
    follow(client, job["id"], "aborted")
    assert board.wants_compensation is None


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
