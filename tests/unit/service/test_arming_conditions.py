"""Nothing moves while a condition of the machine is not as it has to be."""

from dataclasses import replace

import pytest

from arming import arm_over_http
from truepath.machines.cell_status import CellStatus, ControllerLevels
from truepath.machines.conditions.condition_board import ConditionBoard
from truepath.machines.conditions.conditions import Finding, Level, Observed
from truepath.machines.conditions.stream_watch import StreamLevels
from truepath_drivers.interfaces.records import MotionState, MotionStatus

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
    client, seen, board, take
):
    job = take("ready", kind="measure-otf", control_compensation="off")
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


def test_a_job_that_waits_says_what_it_wants_of_the_control(client, board, take, until):
    for asked, wants in (({}, None), ({"control_compensation": "on"}, True)):
        job = take("ready", kind="measure-otf", **asked)
        assert board.wants_compensation is wants
        client.post(f"/api/v1/jobs/{job['id']}/abort")
        until(job, "aborted")
        assert board.wants_compensation is None
