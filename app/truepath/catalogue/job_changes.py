"""How a job may change: the effect of each change, and its errors.

Each returns the same object where nothing changes.
"""

from __future__ import annotations

from dataclasses import replace

from truepath.catalogue.errors import GivenUp, StaleVersion
from truepath.catalogue.job import Failure, Health, Job, Progress, Stage, format_utc_now
from truepath.catalogue.transitions import State, Verb, apply_verb, may_follow
from truepath.errors import IllegalTransition

MAX_ATTEMPTS = 2

_DESIRED_STATES = {
    Verb.ARM: str(State.RUNNING),
    Verb.PAUSE: str(State.PAUSED),
    Verb.RESUME: str(State.RUNNING),
    Verb.CANCEL: str(State.CANCELLED),
    Verb.ABORT: str(State.ABORTED),
    Verb.ACKNOWLEDGE: str(State.READY),
}
_ENDS_ASKED_FOR = {
    State.ABORTING: State.ABORTED,
    State.CANCELLING: State.CANCELLED,
}


def apply_request(job: Job, verb: Verb) -> Job:
    """The job after a user's request. Raises IllegalTransition."""
    state, desired = apply_verb(verb, job.state), _DESIRED_STATES[verb]
    if state is job.state and (job.is_final or job.desired_state == desired):
        return job
    return replace(job, state=state, desired_state=desired)


def enter_state(
    job: Job, state: State, stage: Stage, progress: Progress, health: Health
) -> Job:
    """The job in a state or a stage, if the table allows it; else unchanged."""
    allowed = job.state is state or may_follow(job.state, state)
    unchanged = (job.state, job.stage) == (state, stage)
    if not allowed or unchanged:
        return job
    # Once the machine moves, the request for a pause is over.
    moves = state is State.RUNNING and job.wants_pause
    return replace(
        job,
        state=state,
        desired_state=str(state) if moves else job.desired_state,
        stage=stage,
        progress=progress,
        health=health,
        attempts=job.attempts + (job.state is State.QUEUED),
    )


def set_failure(job: Job, failure: Failure | None) -> Job:
    """The job with the reason why the machine stopped, paused if it was resuming.

    failure : None when the machine moves
    """
    if job.is_final:
        return job
    if failure is not None and job.state is State.RESUMING:
        held = {"state": State.PAUSED, "desired_state": str(State.PAUSED)}
        return replace(job, **held, failure=failure)
    return job if job.failure == failure else replace(job, failure=failure)


def end_job(
    job: Job,
    state: State,
    failure: Failure | None,
    stage: Stage,
    progress: Progress,
    health: Health,
) -> Job:
    """The job ended; an abort or cancel in progress overrides success."""
    if job.is_final:
        return job
    asked = _ENDS_ASKED_FOR.get(job.state, state)
    final = state if may_follow(job.state, state) else asked
    kept = None if final is asked is not state else failure
    return replace(
        job,
        state=final,
        stage=stage,
        failure=kept,
        progress=progress,
        health=health,
    )


def reopen_measurement(job: Job, machine_version: int) -> Job:
    """An interrupted measurement, in preparation again.

    machine_version : of the configuration that it continues with
    """
    return replace(
        job,
        state=apply_verb(Verb.ACKNOWLEDGE, job.state),
        desired_state=str(State.READY),
        stage=Stage.WAITING,
        failure=None,
        ended=None,
        machine_version=machine_version if job.machine else job.machine_version,
    )


def requeue(job: Job, *, in_order: bool = False) -> Job:
    """The job queued again, or ended where it may not be started once more.

    The same object where nothing changes. A job that measures is never passed here.

    in_order : the service ended in order, which is no failed attempt of the job
    """
    if job.is_final or job.state is State.QUEUED:
        return job
    if job.state is State.ABORTING:
        return replace(job, state=State.ABORTED)
    if job.state is State.CANCELLING:
        return replace(job, state=State.CANCELLED)
    attempts = job.attempts - in_order
    if attempts >= MAX_ATTEMPTS:
        text = f"the service ended {attempts} times while the job was computing"
        failure = Failure(GivenUp.__name__, text)
        return replace(job, state=State.FAILED, failure=failure)
    return replace(
        job,
        state=State.QUEUED,
        stage=Stage.WAITING,
        progress=Progress(),
        attempts=attempts,
    )


def require_version(job: Job, version: int) -> None:
    """Raise StaleVersion if the job has changed since that version."""
    if job.version != version:
        raise StaleVersion(version, job.version, job.state)


def reject_to_measure_again(job: Job) -> None:
    """Raise IllegalTransition for a measurement that would be queued again."""
    if job.kind.measures and job.state is State.QUEUED:
        raise IllegalTransition(f"job {job.id} measures; it is not begun again")


def stamp_times(before: Job, after: Job) -> Job:
    """Set `started` or `ended` where the change is a start or an end."""
    if after.started is None and after.state is State.RUNNING:
        return replace(after, started=format_utc_now())
    is_end = after.is_final and not before.is_final
    return replace(after, ended=format_utc_now()) if is_end else after
