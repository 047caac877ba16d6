"""Nothing moves without a token of exactly this plan, user, machine and moment."""

from dataclasses import replace

import pytest

from arming import arm_at_once
from job_builders import ROWS
from scripted_cell import wait_until
from truepath.catalogue import errors, job
from truepath.catalogue.transitions import State, Verb
from truepath.errors import IllegalTransition
from truepath.jobs.running import arming as what_moves
from truepath.jobs.running.arming import ArmingPurpose, ArmTokens
from truepath.motion.paths.commanded_rows import command_rows

PURPOSE = ArmingPurpose("job", 3, "anna", "mill", 1, "ab")


@pytest.fixture
def dispatcher(hand_clock, context, open_dispatcher):
    """Tokens are good for 60 s of the test's clock."""
    context.require_cell().start()
    return open_dispatcher()


@pytest.fixture
def changed(ready, context):
    def change():
        plan = dict(context.store.read_plan(ready.id))
        plan["position"][1][0] += 0.001
        context.store.store_plan(ready.id, plan)

    return change


@pytest.fixture
def refused(dispatcher, ready, make_cell):
    def see(error, token, match, *, by=None, version=None):
        with pytest.raises(error, match=match):
            dispatcher.arm(ready.id, version or ready.version, token, by=by)
        assert "begin" not in make_cell.cell.heard

    return see


@pytest.mark.fault_row(34)
def test_a_token_of_this_plan_moves_the_machine_once(dispatcher, ready, make_cell):
    arming = dispatcher.prepare_arming(ready.id)
    # Its stored state counts, which its thread may not know yet.
    dispatcher._active_jobs.require(ready.id, Verb.ARM).state = State.PREPARING
    assert dispatcher.arm(ready.id, ready.version, arming.token).state == "running"
    assert make_cell.cell.begun.wait(5)
    driven = [make_cell.cell.order.commanded]
    assert what_moves.hash_commanded(driven) == arming.plan_sha256
    with pytest.raises(IllegalTransition, match="running"):
        dispatcher.prepare_arming(ready.id)
    make_cell.cell.end()
    wait_until(lambda: not dispatcher.is_measuring)


@pytest.mark.fault_row(34)
@pytest.mark.parametrize("token", ["", "x" * 200, "\udcff", "0"])
def test_a_token_that_nobody_was_given_moves_nothing(refused, dispatcher, ready, token):
    refused(errors.ArmTokenOther, token, "knows no such token")
    dispatcher.prepare_arming(ready.id)
    refused(errors.ArmTokenOther, token, "knows no such token")


@pytest.mark.fault_row(33)
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
def test_a_token_is_bound_to_each_part_of_its_purpose_and_good_once(change, named):
    tokens = ArmTokens()
    token = tokens.issue(PURPOSE)
    with pytest.raises(errors.ArmTokenOther, match=f"for another {named}"):
        tokens.use(token, replace(PURPOSE, **change))
    tokens.use(token, PURPOSE)  # it was not used up
    with pytest.raises(errors.ArmTokenUsed):
        tokens.use(token, PURPOSE)


@pytest.mark.fault_row(34)
def test_an_old_token_moves_nothing(refused, dispatcher, ready, hand_clock, changed):
    token = dispatcher.prepare_arming(ready.id).token
    hand_clock.time_s += 60.0
    refused(errors.ArmTokenExpired, token, "60 s, which have passed")
    token = dispatcher.prepare_arming(ready.id).token
    changed()
    refused(errors.ArmTokenOther, token, "for another plan")


@pytest.mark.fault_row(34)
def test_only_the_rows_armed_are_driven(dispatcher, ready, changed, until, make_cell):
    """The plan was changed before the summary was asked for, after the job read it."""
    changed()
    arm_at_once(dispatcher, ready.id, ready.version)
    assert "armed for" in until(ready, "failed").failure.detail
    assert "begin" not in make_cell.cell.heard


@pytest.mark.fault_row(33)
def test_a_token_of_another_user_moves_nothing(dispatcher, ready, refused):
    dispatcher.take_control(ready.id, "anna")
    token = dispatcher.prepare_arming(ready.id, by="anna").token
    with pytest.raises(errors.NotInControl):
        dispatcher.prepare_arming(ready.id, by="ben")
    dispatcher.take_control(ready.id, "ben")
    refused(errors.ArmTokenOther, token, "another user", by="ben")


@pytest.mark.fault_row(33)
def test_a_stale_version_leaves_the_token_good(refused, dispatcher, ready):
    token = dispatcher.prepare_arming(ready.id).token
    stale = ready.version - 1
    refused(errors.StaleVersion, token, "not the current one", version=stale)
    assert dispatcher.arm(ready.id, ready.version, token).state is State.RUNNING


def test_a_service_started_anew_knows_no_token(dispatcher, ready, open_dispatcher):
    token = dispatcher.prepare_arming(ready.id).token
    dispatcher.close()
    with pytest.raises(IllegalTransition):
        open_dispatcher().arm(ready.id, ready.version, token)


def summarise(machine, kind=job.JobKind.MEASURE_OTF, *here):
    rows = (
        {**ROWS[0], "y_mm": 300.0, "feed_mm_min": 2000.0, "dwell_s": 1.0},
        {**ROWS[1], "y_mm": 30.0, "z_mm": 10.0, "dwell_s": 0.5},
    )
    path = command_rows(machine, rows, is_path=True)
    motion = what_moves.summarise_motion(machine, kind, [path], *here)
    return motion, [(one.axis, one.low, one.high) for one in motion.envelope]


def test_the_summary_is_of_the_rows_and_the_way_to_them_or_the_whole_travel(machine):
    motion, ranges = summarise(machine)
    assert ranges == [("X", 10.0, 400.0), ("Y", 30.0, 300.0), ("Z", 10.0, 10.0)]
    assert (motion.max_feed_mm_min, motion.rows, motion.grows) == (2000.0, 2, False)
    # 474 mm at 1000 mm/min take 28.5 s, dwells 1.5 s, ramps a little.
    assert 29.9 < motion.duration_s < 31.0
    here = {"X": 450.0, "Y": 200.0, "Z": 0.0, "W": 900.0}
    _, ranges = summarise(machine, job.JobKind.MEASURE_OTF, here)
    assert ranges == [("X", 10.0, 450.0), ("Y", 30.0, 300.0), ("Z", 0.0, 10.0)]
    motion, ranges = summarise(machine, job.JobKind.MEASURE_ADAPTIVE)
    assert motion.grows
    assert ranges == [(axis.name, axis.low, axis.high) for axis in machine.axes]


def test_of_several_stations_those_that_are_left_are_commanded():
    rows = {"kind": "points", "axes": ["X"], "dwell_s": [1.0], "target": []}
    one, two = {**rows, "position": [[1.0]]}, {**rows, "position": [[2.0]]}
    plan = {"known_points": one, "stations": [{**one, "measured": True}, two]}
    parts = what_moves.list_commanded(plan)
    assert [part.position.tolist() for part in parts] == [[[1.0]], [[2.0]]]
