"""The states of a job and what may follow what: data, in one place."""

from __future__ import annotations

from enum import StrEnum

from truepath.errors import IllegalTransition


class State(StrEnum):
    """Where a job is. The last six are final: nothing of the job is under way."""

    QUEUED = "queued"  # waits for a worker process, or for its thread
    PREPARING = "preparing"  # devices are connected, the plan is checked
    READY = "ready"  # waits to be armed; nothing has moved
    RUNNING = "running"
    AWAITING_MOVE = "awaiting-move"  # of the tracker; nothing moves until armed again
    PAUSING = "pausing"  # feed hold requested, not yet confirmed
    PAUSED = "paused"
    RESUMING = "resuming"
    CANCELLING = "cancelling"  # the line or point under way is finished first
    ABORTING = "aborting"  # abort requested, not yet confirmed
    CANCELLED = "cancelled"
    ABORTED = "aborted"
    SUCCEEDED = "succeeded"
    FAILED = "failed"  # it could not be done; the machine is as it was left
    FAULTED = "faulted"  # machine, tracker or link failed: an operator has to check
    INTERRUPTED = "interrupted"  # the service ended first


class Verb(StrEnum):
    """What a user may ask of a job."""

    ARM = "arm"
    PAUSE = "pause"
    RESUME = "resume"
    CANCEL = "cancel"  # finish the line or point, leave out the rest
    ABORT = "abort"
    ACKNOWLEDGE = "acknowledge"  # an operator has checked; a measurement may continue


_Q, _P, _R = State.QUEUED, State.PREPARING, State.READY
_RUN, _PSG, _PSD, _RES = State.RUNNING, State.PAUSING, State.PAUSED, State.RESUMING
_CNG, _ABG, _AWAIT = State.CANCELLING, State.ABORTING, State.AWAITING_MOVE

_ENDS_BADLY = frozenset({State.FAILED, State.FAULTED, State.INTERRUPTED})
FINAL = _ENDS_BADLY | {State.ABORTED, State.CANCELLED, State.SUCCEEDED}
LEFT_BY_ACKNOWLEDGE = frozenset({State.FAULTED, State.INTERRUPTED})
"""Final states that a measurement may leave; the others are never left."""

TRANSITIONS: dict[State, frozenset[State]] = {
    _Q: frozenset({_P, _RUN, _CNG, _ABG}) | _ENDS_BADLY,
    _P: frozenset({_R, _CNG, _ABG}) | _ENDS_BADLY,
    _R: frozenset({_RUN, _CNG, _ABG}) | _ENDS_BADLY,
    # A hold or a cycle start at the machine's own panel skips pausing and resuming.
    # Computing is begun again after a restart of the service; a measurement never is.
    _RUN: frozenset({_PSG, _PSD, _AWAIT, _CNG, _ABG, _Q, State.SUCCEEDED})
    | _ENDS_BADLY,
    _AWAIT: frozenset({_RUN, _CNG, _ABG}) | _ENDS_BADLY,
    # The path may end while the hold is on its way.
    _PSG: frozenset({_PSD, _RUN, _AWAIT, _CNG, _ABG}) | _ENDS_BADLY,
    # A measurement that is given up ends while it is held.
    _PSD: frozenset({_RES, _RUN, _AWAIT, _CNG, _ABG}) | _ENDS_BADLY,
    _RES: frozenset({_RUN, _PSG, _PSD, _AWAIT, _CNG, _ABG}) | _ENDS_BADLY,
    _CNG: frozenset({_ABG, State.CANCELLED}) | _ENDS_BADLY,
    # An abort without confirmation is a fault; one that loses its process is one as
    # well.
    _ABG: frozenset({State.ABORTED, State.FAULTED, State.INTERRUPTED}),
    **dict.fromkeys(FINAL, frozenset[State]()),
    # It is prepared and armed again; nothing moves by this alone.
    **dict.fromkeys(LEFT_BY_ACKNOWLEDGE, frozenset({_P})),
}

PAUSE_STATES = frozenset({_PSG, _PSD})
"""A pause is on its way or in force."""

MOVE_STATES = frozenset({_RUN, _RES}) | PAUSE_STATES
"""The machine moves, or may continue automatically."""

# verb -> states it acts in -> the state it leads to. In the states of `VERB_SATISFIED`
# it has been obeyed already and changes nothing.
VERB_TRANSITIONS: dict[Verb, dict[State, State]] = {
    Verb.ARM: {_R: _RUN, _AWAIT: _RUN},
    Verb.PAUSE: {_RUN: _PSG, _RES: _PSG},
    Verb.RESUME: {_PSD: _RES},
    Verb.CANCEL: {state: _CNG for state in State if state not in FINAL | {_CNG, _ABG}},
    Verb.ABORT: {
        state: _ABG for state in State if state not in FINAL and state != _ABG
    },
    Verb.ACKNOWLEDGE: dict.fromkeys(LEFT_BY_ACKNOWLEDGE, _P),
}
VERB_SATISFIED: dict[Verb, frozenset[State]] = {
    Verb.ARM: frozenset(),
    Verb.PAUSE: PAUSE_STATES,
    Verb.RESUME: frozenset({_RUN, _RES}),
    Verb.CANCEL: FINAL | {_CNG},
    Verb.ABORT: FINAL | {_ABG},
    Verb.ACKNOWLEDGE: frozenset({_P, _R}),
}


def may_follow(before: State, after: State) -> bool:
    """Whether the table allows the change."""
    return after in TRANSITIONS[before]


def apply_verb(verb: Verb, state: State) -> State:
    """The state a verb leads to, the same where it is in effect already.

    Raises IllegalTransition; abort never.
    """
    if state in VERB_SATISFIED[verb]:
        return state
    if state not in VERB_TRANSITIONS[verb]:
        allowed = ", ".join(sorted(VERB_TRANSITIONS[verb]))
        raise IllegalTransition(f"cannot {verb} a job that is {state}; only {allowed}")
    return VERB_TRANSITIONS[verb][state]


def check_transition(before: State, after: State) -> None:
    """Raise IllegalTransition if the table does not allow the change."""
    if not may_follow(before, after):
        raise IllegalTransition(f"a job that is {before} cannot become {after}")
