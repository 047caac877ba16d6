from contextlib import suppress

import pytest

from truepath.catalogue import transitions as table
from truepath.catalogue.transitions import FINAL, TRANSITIONS, State, Verb, apply_verb
from truepath.errors import IllegalTransition


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
