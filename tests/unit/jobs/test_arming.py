"""Nothing moves without a token of this plan and moment, nor against the states."""

from contextlib import suppress
from dataclasses import replace

import pytest

from job_builders import ROWS, arm_at_once
from scripted_cell import wait_until
from truepath.catalogue import errors, job
from truepath.catalogue import transitions as table
from truepath.catalogue.transitions import FINAL, TRANSITIONS, State, Verb, apply_verb
from truepath.errors import IllegalTransition
from truepath.jobs.running import arming as what_moves
from truepath.jobs.running.arming import ArmingPurpose, ArmTokens
from truepath.motion.paths.commanded_rows import command_rows

PURPOSE = ArmingPurpose("job", 3, "anna", "mill", 1, "ab")


@pytest.fixture
def dispatcher(hand_clock, open_dispatcher):
    """Tokens are good for 60 s of the test's clock."""
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


def find_all(first, list_next):
    reached, front = {first}, {first}
    while front:
        front = set().union(*map(list_next, front)) - reached
        reached |= front
    return reached


def test_every_state_stands_in_the_table_can_be_reached_and_has_an_end_in_reach():
    assert set(TRANSITIONS) == set(State)
    assert find_all(State.QUEUED, TRANSITIONS.get) == set(State)
    assert all(state in FINAL or after & FINAL for state, after in TRANSITIONS.items())


def test_the_six_ends_are_never_left_and_an_abort_leaves_them_as_they_are():
    ends = {"aborted", "cancelled", "succeeded", "failed", "faulted", "interrupted"}
    assert set(map(str, FINAL)) == ends
    for state in FINAL:
        assert apply_verb(Verb.ABORT, state) is state
        for after in set(State) if state not in table.LEFT_BY_ACKNOWLEDGE else ():
            with pytest.raises(IllegalTransition):
                table.check_transition(state, after)


@pytest.mark.parametrize("state", sorted(set(State) - FINAL))
@pytest.mark.fault_row(34)
def test_abort_is_accepted_in_every_state_that_is_not_final(state, measured):
    assert apply_verb(Verb.ABORT, state) is State.ABORTING
    measured(f"abort from {state}")


@pytest.mark.parametrize("verb", sorted(Verb))
@pytest.mark.fault_row(34)
def test_a_verb_leads_where_the_table_goes_and_said_twice_is_said_once_or_refused(verb):
    leads = table.VERB_TRANSITIONS[verb]
    for state, after in leads.items():
        assert table.may_follow(state, after)
    for state in State:
        if state not in leads and state not in table.VERB_SATISFIED[verb]:
            with pytest.raises(IllegalTransition, match=f"cannot {verb} a job that is"):
                apply_verb(verb, state)
            continue
        once = apply_verb(verb, state)
        assert verb is Verb.ARM or apply_verb(verb, once) is once


@pytest.mark.fault_row(34)
def test_each_state_that_a_person_leaves_is_left_by_these_verbs_alone():
    """Only arming starts a measurement; a fault is left by acknowledging it."""
    for state, verbs in (
        (State.READY, [Verb.ABORT, Verb.ARM, Verb.CANCEL]),
        (State.CANCELLING, [Verb.ABORT]),
        *((state, [Verb.ACKNOWLEDGE]) for state in table.LEFT_BY_ACKNOWLEDGE),
    ):
        assert sorted(v for v in Verb if state in table.VERB_TRANSITIONS[v]) == verbs
    for state in table.LEFT_BY_ACKNOWLEDGE:
        assert TRANSITIONS[state] == {State.PREPARING}


def list_unarmed(state):
    """What follows without arming: by other verbs, and by the worker itself.

    It never leaves `ready` for motion, and only a person leaves what is acknowledged.
    """
    after = set() if state in table.LEFT_BY_ACKNOWLEDGE else set(TRANSITIONS[state])
    if state in {State.READY, State.QUEUED}:
        after.discard(State.RUNNING)
    for verb in set(Verb) - {Verb.ARM}:
        with suppress(IllegalTransition):
            after.add(apply_verb(verb, state))
    return after


def test_nothing_moves_before_it_is_armed_whatever_is_asked_or_happens():
    reached = find_all(State.QUEUED, list_unarmed)
    moving = {State.RUNNING, State.PAUSING, State.PAUSED, State.RESUMING}
    assert State.READY in reached
    assert State.FAULTED in reached, "and what is acknowledged is armed anew"
    assert not reached & moving
