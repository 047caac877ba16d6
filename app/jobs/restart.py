"""What becomes of a job that the end of the service, or a fault, has cut short."""

from __future__ import annotations

from dataclasses import replace

from truepath.app.jobs.errors import GivenUp
from truepath.app.jobs.job import Failure, Job, Progress, Stage
from truepath.app.jobs.transitions import State, Verb, apply_verb

MAX_ATTEMPTS = 2


def leave_end(job: Job, machine_version: int) -> Job:
    """Return a measurement that was cut short, in preparation again.

    machine_version : of the configuration that it goes on with
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


def put_back(job: Job, *, in_order: bool = False) -> Job:
    """Return the job queued again, or ended where it may not be begun once more.

    The same object where nothing changes. A job that measures is never passed here.

    in_order : the service was told to end, which is no failed attempt of the job
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
