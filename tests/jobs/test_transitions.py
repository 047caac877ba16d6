from __future__ import annotations

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from truepath.catalogue.transitions import (
    FINAL,
    LEFT_BY_ACKNOWLEDGE,
    TRANSITIONS,
    VERB_SATISFIED,
    VERB_TRANSITIONS,
    State,
    Verb,
    apply_verb,
    check_transition,
    may_follow,
)
from truepath.errors import IllegalTransition


def test_every_state_stands_in_the_table():
    assert set(TRANSITIONS) == set(State)


def test_the_final_states_are_the_six_ends():
    ends = {"aborted", "cancelled", "succeeded", "failed", "faulted", "interrupted"}
    assert {str(state) for state in FINAL} == ends


def test_every_state_can_be_reached_from_the_first():
    reached, front = {State.QUEUED}, {State.QUEUED}
    while front:
        front = set().union(*(TRANSITIONS[state] for state in front)) - reached
        reached |= front
    assert reached == set(State)


@pytest.mark.parametrize("state", sorted(set(State) - FINAL))
@pytest.mark.fault_row(34)
def test_abort_is_accepted_in_every_state_that_is_not_final(state, measured):
    assert apply_verb(Verb.ABORT, state) is State.ABORTING
    measured(f"abort from {state}")


@pytest.mark.parametrize("state", sorted(FINAL))
def test_abort_leaves_an_ended_job_as_it_is(state):
    assert apply_verb(Verb.ABORT, state) is state


@pytest.mark.parametrize("verb", sorted(Verb))
@pytest.mark.fault_row(34)
def test_a_verb_leads_only_where_the_table_goes(verb):
    for state, after in VERB_TRANSITIONS[verb].items():
        assert may_follow(state, after)


@pytest.mark.parametrize("verb", sorted(Verb))
@pytest.mark.parametrize("state", sorted(State))
def test_a_verb_said_twice_is_said_once_or_refused(verb, state):
    if state not in VERB_TRANSITIONS[verb] and state not in VERB_SATISFIED[verb]:
        with pytest.raises(IllegalTransition, match=f"cannot {verb} a job that is"):
            apply_verb(verb, state)
        return
    once = apply_verb(verb, state)
    if verb is not Verb.ARM:
        assert apply_verb(verb, once) is once


def test_only_arming_starts_a_measurement():
    starts = [verb for verb in Verb if State.READY in VERB_TRANSITIONS[verb]]
    assert sorted(starts) == [Verb.ABORT, Verb.ARM, Verb.CANCEL]


@pytest.mark.fault_row(34)
def test_a_fault_or_an_interruption_is_left_only_by_acknowledging_it():
    for state in LEFT_BY_ACKNOWLEDGE:
        leaving = [verb for verb in Verb if state in VERB_TRANSITIONS[verb]]
        assert leaving == [Verb.ACKNOWLEDGE]
        assert TRANSITIONS[state] == {State.PREPARING}


def test_a_cancelled_job_can_still_be_aborted_and_is_never_moved_again():
    assert apply_verb(Verb.ABORT, State.CANCELLING) is State.ABORTING
    for verb in (Verb.PAUSE, Verb.RESUME, Verb.ARM):
        with pytest.raises(IllegalTransition):
            apply_verb(verb, State.CANCELLING)


def test_a_final_state_is_never_left():
    for state in FINAL - LEFT_BY_ACKNOWLEDGE:
        for after in State:
            with pytest.raises(IllegalTransition):
                check_transition(state, after)


class AnyJob(RuleBasedStateMachine):
    """Verbs of users and changes by the worker, in any order."""

    def __init__(self) -> None:
        super().__init__()
        self.state = State.QUEUED
        self.armed = False

    @rule(verb=st.sampled_from(list(Verb)))
    def user(self, verb: Verb) -> None:
        before = self.state
        try:
            self.state = apply_verb(verb, before)
        except IllegalTransition:
            assert verb is not Verb.ABORT
        self.armed |= verb is Verb.ARM and before is State.READY
        if before in LEFT_BY_ACKNOWLEDGE and self.state is State.PREPARING:
            self.armed = False  # it has to be armed anew

    @rule(data=st.data())
    def worker(self, data: st.DataObject) -> None:
        # The worker of a measurement never leaves `ready` for motion by itself.
        after = TRANSITIONS[self.state]
        if self.state in LEFT_BY_ACKNOWLEDGE:
            after = frozenset[State]()  # left by a person only
        if self.state in {State.READY, State.QUEUED}:
            after = after - {State.RUNNING}
        if after:
            self.state = data.draw(st.sampled_from(sorted(after)))

    @invariant()
    def abort_is_always_obeyed(self) -> None:
        after = apply_verb(Verb.ABORT, self.state)
        assert after is State.ABORTING or after in FINAL

    @invariant()
    def nothing_moves_unarmed(self) -> None:
        moving = {State.RUNNING, State.PAUSING, State.PAUSED, State.RESUMING}
        assert self.armed or self.state not in moving

    @invariant()
    def some_end_is_always_in_reach(self) -> None:
        assert self.state in FINAL or TRANSITIONS[self.state] & FINAL


TestAnyJob = AnyJob.TestCase
TestAnyJob.settings = settings(max_examples=100, stateful_step_count=30, deadline=None)
