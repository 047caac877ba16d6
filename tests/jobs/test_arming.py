"""Nothing moves without a token of exactly this plan, user, machine and moment."""

from __future__ import annotations

from dataclasses import replace

import pytest
from scripted_cell import wait_until

from truepath.catalogue.errors import (
    ArmTokenExpired,
    ArmTokenOther,
    ArmTokenUsed,
    NotInControl,
    StaleVersion,
)
from truepath.catalogue.job import JobKind
from truepath.catalogue.transitions import State
from truepath.errors import IllegalTransition
from truepath.jobs.dispatch.arm_tokens import ArmingPurpose, ArmTokens
from truepath.jobs.dispatch.dispatcher import Dispatcher
from truepath.jobs.kinds.requested_job import RequestedJob
from truepath.jobs.running.arming import (
    hash_commanded,
    list_commanded,
    summarise_motion,
)
from truepath.motion.paths.commanded_rows import command_rows

ROWS = (
    {"x_mm": 10.0, "y_mm": 300.0, "z_mm": 10.0, "feed_mm_min": 2000.0, "dwell_s": 1.0},
    {"x_mm": 400.0, "y_mm": 30.0, "z_mm": 10.0, "feed_mm_min": 1000.0, "dwell_s": 0.5},
)
OFF_THE_LINE = {"x_mm": 100.0, "y_mm": 350.0, "z_mm": 50.0}
OTF = RequestedJob(JobKind.MEASURE_OTF, rows=(*ROWS, OFF_THE_LINE))


@pytest.fixture
def dispatcher(context, event_bus, hand_clock):
    """Tokens are good for 60 s of the test's clock."""
    context.require_cell().start()
    dispatcher = Dispatcher(context, event_bus, ArmTokens(60.0))
    yield dispatcher
    dispatcher.close()


@pytest.fixture
def ready(dispatcher, until):
    """A job that waits to be armed."""
    return until(dispatcher.create(OTF)[0], "ready")


@pytest.fixture
def refused(dispatcher, ready, make_cell):
    """Sees arming refused, and that nothing moves by it."""

    def see(error, token, match, *, by=None, version=None):
        with pytest.raises(error, match=match):
            dispatcher.arm(ready.id, version or ready.version, token, by=by)
        assert "begin" not in make_cell.cell.heard

    return see


@pytest.mark.fault_row(34)
def test_a_token_of_this_plan_moves_the_machine_once(
    dispatcher, ready, make_cell, until
):
    arming = dispatcher.prepare_arming(ready.id)
    assert dispatcher.arm(ready.id, ready.version, arming.token).state == "running"
    assert make_cell.cell.begun.wait(5)
    commanded = make_cell.cell.order.commanded
    assert hash_commanded([commanded]) == arming.plan_sha256


@pytest.mark.fault_row(34)
@pytest.mark.parametrize("token", ["", "x" * 200, "\udcff", "0"])
def test_a_token_that_nobody_was_given_moves_nothing(refused, dispatcher, ready, token):
    refused(ArmTokenOther, token, "knows no such token")
    dispatcher.prepare_arming(ready.id)
    refused(ArmTokenOther, token, "knows no such token")


@pytest.mark.fault_row(34)
def test_a_token_expires(refused, dispatcher, ready, hand_clock):
    token = dispatcher.prepare_arming(ready.id).token
    hand_clock.time_s += 60.0
    refused(ArmTokenExpired, token, "60 s, which have passed")


@pytest.mark.fault_row(33)
def test_a_token_is_good_once():
    tokens, purpose = ArmTokens(), make_purpose()
    token = tokens.issue(purpose)
    tokens.use(token, purpose)
    with pytest.raises(ArmTokenUsed):
        tokens.use(token, purpose)


def make_purpose():
    return ArmingPurpose("job", 3, "anna", "mill", 1, "ab")


@pytest.mark.fault_row(34)
@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"user": None}, "user"),
        ({"user": "ben"}, "user"),
        ({"machine_id": "lathe"}, "machine"),
        ({"machine_version": 2}, "configuration of the machine"),
        ({"job_id": "other"}, "job"),
        ({"plan_sha256": "ac"}, "plan"),
        ({"version": 4}, "state of the job"),
    ],
)
def test_a_token_is_bound_to_each_part_of_its_purpose(change, named):
    tokens = ArmTokens()
    token = tokens.issue(make_purpose())
    with pytest.raises(ArmTokenOther, match=f"for another {named}"):
        tokens.use(token, replace(make_purpose(), **change))
    tokens.use(token, make_purpose())  # it was not used up


@pytest.mark.fault_row(34)
def test_a_plan_that_has_changed_since_moves_nothing(
    refused, dispatcher, ready, context
):
    token = dispatcher.prepare_arming(ready.id).token
    plan = dict(context.store.read_plan(ready.id))
    plan["position"][1][0] += 0.001
    context.store.keep_plan(ready.id, plan)
    refused(ArmTokenOther, token, "for another plan")


@pytest.mark.fault_row(34)
def test_rows_that_are_not_those_armed_are_not_driven(
    dispatcher, ready, context, until, make_cell
):
    """The plan was changed before the summary was asked for, after the job read it."""
    plan = dict(context.store.read_plan(ready.id))
    plan["position"][1][0] += 0.001
    context.store.keep_plan(ready.id, plan)
    arming = dispatcher.prepare_arming(ready.id)
    dispatcher.arm(ready.id, ready.version, arming.token)
    assert "armed for" in until(ready, "failed").failure.detail
    assert "begin" not in make_cell.cell.heard


@pytest.mark.fault_row(33)
def test_a_token_of_another_user_moves_nothing(dispatcher, ready, refused):
    dispatcher.take_control(ready.id, "anna")
    token = dispatcher.prepare_arming(ready.id, by="anna").token
    with pytest.raises(NotInControl):
        dispatcher.prepare_arming(ready.id, by="ben")
    dispatcher.take_control(ready.id, "ben")
    refused(ArmTokenOther, token, "another user", by="ben")


@pytest.mark.fault_row(33)
def test_a_stale_version_leaves_the_token_good(refused, dispatcher, ready):
    token = dispatcher.prepare_arming(ready.id).token
    refused(StaleVersion, token, "not the current one", version=ready.version - 1)
    assert dispatcher.arm(ready.id, ready.version, token).state is State.RUNNING


def test_a_service_that_was_started_anew_knows_no_token(
    dispatcher, ready, context, event_bus
):
    token = dispatcher.prepare_arming(ready.id).token
    dispatcher.close()
    again = Dispatcher(context, event_bus)
    with pytest.raises(IllegalTransition):
        again.arm(ready.id, ready.version, token)
    again.close()


def test_only_a_job_that_waits_to_be_armed_says_what_will_move(
    dispatcher, ready, make_cell
):
    dispatcher.arm(ready.id, ready.version, dispatcher.prepare_arming(ready.id).token)
    assert make_cell.cell.begun.wait(5)
    with pytest.raises(IllegalTransition, match="running"):
        dispatcher.prepare_arming(ready.id)
    make_cell.cell.end()
    wait_until(lambda: not dispatcher.is_measuring)


def test_the_summary_is_that_of_the_rows(machine):
    rows = command_rows(machine, ROWS, is_path=True)
    motion = summarise_motion(machine, JobKind.MEASURE_OTF, [rows])
    ranges = {one.axis: (one.low, one.high) for one in motion.envelope}
    assert ranges == {"X": (10.0, 400.0), "Y": (30.0, 300.0), "Z": (10.0, 10.0)}
    assert (motion.max_feed_mm_min, motion.rows, motion.grows) == (2000.0, 2, False)
    # 474 mm at 1000 mm/min take 28.5 s, dwells 1.5 s, ramps a little.
    assert 29.9 < motion.duration_s < 31.0


def test_the_way_from_where_the_machine_stands_is_in_the_envelope(machine):
    rows = command_rows(machine, ROWS, is_path=True)
    here = {"X": 450.0, "Y": 200.0, "Z": 0.0, "W": 900.0}
    motion = summarise_motion(machine, JobKind.MEASURE_OTF, [rows], here)
    ranges = {one.axis: (one.low, one.high) for one in motion.envelope}
    assert ranges == {"X": (10.0, 450.0), "Y": (30.0, 300.0), "Z": (0.0, 10.0)}


def test_a_measurement_that_grows_may_go_anywhere_in_the_travel(machine):
    rows = command_rows(machine, ROWS, is_path=True)
    motion = summarise_motion(machine, JobKind.MEASURE_ADAPTIVE, [rows])
    ranges = [(one.axis, one.low, one.high) for one in motion.envelope]
    assert motion.grows
    assert ranges == [(axis.name, axis.low, axis.high) for axis in machine.axes]


def test_of_several_stations_those_that_are_left_are_commanded():
    rows = {
        "kind": "points",
        "axes": ["X"],
        "position": [[1.0]],
        "dwell_s": [1.0],
        "target": [],
    }
    plan = {
        "known_points": rows,
        "stations": [{**rows, "measured": True}, {**rows, "position": [[2.0]]}],
    }
    parts = list_commanded(plan)
    assert [part.position.tolist() for part in parts] == [[[1.0]], [[2.0]]]
