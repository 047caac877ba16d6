"""Nothing moves while a condition of the machine is not as it has to be."""

from dataclasses import replace

import pytest

from api_builders import arm_over_http
from job_builders import CONNECTED, OBSERVED
from truepath.machines.cell_status import CellStatus, StreamLevels
from truepath.machines.conditions import ConditionLog, Finding, Level

GOOD = replace(OBSERVED, drift_limit_degC=0.5)
WRONG = {
    "devices-connected": {"cell": CellStatus("down", "the port is gone")},
    "watchdog-there": {"cell": replace(CONNECTED, devices={"motion": {}})},
    "disk-has-room": {"free_bytes": 0},
    "target-in-sight": {"stream": StreamLevels(has_beam=False)},
}
REQUIRED = {
    *("controller-answers", "controller-able", "controller-free", "axes-referenced"),
    *("compensation-as-asked", "feed-override-full", "path-within-travel"),
    *("stream-healthy", "temperature-steady"),
    *WRONG,
}


@pytest.fixture
def seen():
    return [GOOD]


@pytest.fixture
def board(seen, hand_clock):
    return ConditionLog(lambda: seen[0])


def test_each_wrong_condition_refuses_arming(client, seen, board, take, make_cell):
    job = take("ready", kind="measure-otf", control_compensation="off")
    lying = board.path
    assert lying.level is Level.TRUE
    for kind, change in WRONG.items():
        seen[0] = replace(GOOD, **change)
        refused = arm_over_http(client, job)
        assert (refused.status_code, refused.json()["code"]) == (409, "not-in-order")
        assert refused.json()["conditions"] == [kind]
    seen[0], board.path = GOOD, Finding(Level.FALSE, "keep-out", "it meets the vice")
    assert arm_over_http(client, job).json()["conditions"] == ["path-within-travel"]
    board.path = lying
    shown = client.post(f"/api/v1/jobs/{job['id']}/arming").json()
    assert make_cell.cell.heard == ["connect"]
    required = {one["type"] for one in shown["conditions"] if one["is_required"]}
    assert required == REQUIRED
    assert arm_over_http(client, job).status_code == 202


def test_a_job_that_waits_says_what_it_wants_of_the_control(client, board, take, until):
    for asked, wants in (({}, None), ({"control_compensation": "on"}, True)):
        job = take("ready", kind="measure-otf", **asked)
        assert board.wants_compensation is wants
        client.post(f"/api/v1/jobs/{job['id']}/abort")
        until(job, "aborted")
        assert board.wants_compensation is None
