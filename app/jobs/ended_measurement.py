"""What is kept of a measurement that has ended: its Runs, and why it was cut short."""

from __future__ import annotations

from dataclasses import replace

import structlog

from truepath.app.jobs.context import JobContext
from truepath.app.jobs.errors import Interrupted, StorageUnavailable
from truepath.app.jobs.job import Failure, Job
from truepath.app.jobs.reconciliation import name_runs, store_runs
from truepath.app.jobs.resumption import list_part_ids
from truepath.app.jobs.station_steps import list_run_ids
from truepath.app.jobs.transitions import State

log = structlog.get_logger(__name__)


def interrupt_job(job: Job, context: JobContext) -> None:
    """Mark a measurement that an earlier service left unfinished, its Runs named."""
    _add_runs(job, context)
    text = f"the service ended while the job was {job.state}"
    after = replace(
        name_runs(job, context),
        state=State.INTERRUPTED,
        failure=Failure(Interrupted.__name__, text),
    )
    context.store.change(job.id, lambda _: after, version=job.version)
    log.warning("job found unfinished", job_id=job.id, was=str(job.state))


def catalogue_runs(job: Job, context: JobContext) -> None:
    """Catalogue and name the Runs of a job that could not be while it lasted."""
    try:
        _add_runs(job, context)
        store_runs(job.id, context)
    except StorageUnavailable as error:
        log.warning("the Runs are not named yet", job_id=job.id, reason=str(error))


def _add_runs(job: Job, context: JobContext) -> None:
    plan = context.store.read_plan(job.id) or {}
    stations = (*list_run_ids(plan), *list_run_ids(plan, "points_id"))
    for run_id in dict.fromkeys((job.id, *list_part_ids(plan), *stations)):
        context.runs.add_measured(run_id)
