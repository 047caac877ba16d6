"""What a job does, written once from top to bottom.

The job's thread runs it. At the checkpoints of its `ActiveJob` it ends early.
"""

from __future__ import annotations

import time

import structlog

from app.jobs.active_job import ActiveJob
from app.jobs.context import JobContext
from app.jobs.errors import StorageUnavailable
from app.jobs.job import Job
from app.jobs.outcome import JobAborted, JobSucceeded, Outcome, classify_error
from app.jobs.steps import JobSteps
from app.jobs.transitions import Verb

TRY_AGAIN_S = 0.5

log = structlog.get_logger(__name__)


def run_job(job: Job, active: ActiveJob, context: JobContext) -> None:
    """Do a job to its end and store how it ended. Raises nothing."""
    with structlog.contextvars.bound_contextvars(job_id=job.id):
        log.info("job begins", kind=str(job.kind))
        outcome: Outcome = JobSucceeded()
        try:
            run_steps(JobSteps(job, active, context))
        except Exception as error:
            outcome = classify_error(error)
        _store_end(active, outcome)


def run_steps(steps: JobSteps) -> None:
    """Plan, measure, analyse, discover: what the kind of the job asks for."""
    kind, run_ids = steps.job.kind, steps.job.run_ids
    if kind.measures:
        steps.enter_preparing()
    if steps.needs_plan:
        steps.plan()
    if kind.measures:
        commanded = steps.read_commanded()
        steps.connect_cell()
        steps.wait_until_armed()
        steps.measure(commanded)
        run_ids = (*run_ids, steps.job.id)
    if kind.analyses:
        steps.analyse(run_ids)
    if kind.discovers:
        steps.discover(run_ids)


def _store_end(active: ActiveJob, outcome: Outcome) -> None:
    """Store the end as soon as the catalogue accepts it."""
    while True:
        try:
            if isinstance(outcome, JobAborted):
                active.apply_verb(Verb.ABORT)
            job = active.end(outcome)
        except StorageUnavailable:
            log.exception("the end of the job cannot be stored yet")
            if active.is_cancelled:  # the next start of the service will find it
                return
            time.sleep(TRY_AGAIN_S)
        else:
            log.info("job ended", state=str(job.state), reason=outcome.failure)
            return
