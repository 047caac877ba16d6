"""Repair of files and catalogue: uncatalogued Runs, jobs that name no Run.

After a full disk, or where a killed cell had its Run open, a Run file may lack its row,
and its job the Run. Both are searched for at the start of the service, when a
measurement has ended, and every `EVERY_S` while none is active.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace

import structlog

from truepath.catalogue.errors import Interrupted, StorageUnavailable
from truepath.catalogue.job import Failure, Job
from truepath.catalogue.transitions import State
from truepath.errors import NotFound
from truepath.jobs.running.context import JobContext
from truepath.jobs.running.resumption import list_part_ids, list_run_ids
from truepath_drivers import host_clock

log = structlog.get_logger(__name__)

EVERY_S = 30.0
LONGEST_PAUSE_S = 600.0
MOST_RUNS = 4  # that are read in one pass


def interrupt_job(job: Job, context: JobContext) -> None:
    """Mark a measurement left by an earlier service, with its Runs."""
    _add_runs(job, context)
    text = f"the service ended while the job was {job.state}"
    after = replace(
        _name_runs(job, context),
        state=State.INTERRUPTED,
        failure=Failure(Interrupted.__name__, text),
    )
    context.store.change(job.id, lambda _: after, version=job.version)
    log.warning("job found unfinished", job_id=job.id, was=str(job.state))


def catalogue_runs(job: Job, context: JobContext) -> None:
    """Catalogue the Runs of a job that could not be stored while it was active."""
    try:
        _add_runs(job, context)
        _store_runs(job.id, context)
    except StorageUnavailable as error:
        log.warning("the Runs are not named yet", job_id=job.id, reason=str(error))


def reconcile(
    context: JobContext, *, skip: Collection[str] = (), most: int | None = None
) -> dict[str, str]:
    """Catalogue Runs without a row, and name Runs in their jobs.

    No measurement may be active. Gives the reason by identifier of each Run that cannot
    be catalogued. Raises StorageUnavailable.

    skip : Runs to ignore; most : largest number of Runs to read
    """
    failed: dict[str, str] = {}
    left = [i for i in context.runs.list_uncatalogued() if i not in skip]
    for run_id in left[:most]:
        try:
            context.runs.read_measured(run_id)
        except StorageUnavailable:
            raise
        except Exception as error:  # any file may lie in the folder
            failed[run_id] = str(error) or type(error).__name__
        else:
            log.info("a Run on disk is catalogued", run_id=run_id)
            _join_job(run_id, context)
    for job in context.store.list_without_run():
        _store_runs(job.id, context)
    return failed


def _add_runs(job: Job, context: JobContext) -> None:
    plan = context.store.read_plan(job.id) or {}
    stations = (*list_run_ids(plan), *list_run_ids(plan, "points_id"))
    for run_id in dict.fromkeys((job.id, *list_part_ids(plan), *stations)):
        context.runs.add_measured(run_id)


def _name_runs(job: Job, context: JobContext) -> Job:
    plan = context.store.read_plan(job.id) or {}
    if "stations" in plan:
        known = context.runs.find(list_run_ids(plan))
        if not known or job.run_ids == tuple(known):
            return job
        return replace(job, run_id=known[0], further_run_ids=tuple(known[1:]))
    made = dict.fromkeys((job.id, *list_part_ids(plan)))
    for run_id in context.runs.find(list(made)):
        job = job if run_id in job.run_ids else job.add_run(run_id)
    return job


def _store_runs(job_id: str, context: JobContext) -> None:
    named = _name_runs(context.store.get(job_id), context)

    def change(job: Job) -> Job:
        runs = named.run_id, named.further_run_ids
        if runs == (job.run_id, job.further_run_ids):
            return job
        return replace(job, run_id=runs[0], further_run_ids=runs[1])

    context.store.change(job_id, change)


def _join_job(run_id: str, context: JobContext) -> None:
    try:
        _store_runs(context.runs.read_job_id(run_id), context)
    except NotFound:
        log.warning("no job has recorded this Run", run_id=run_id)


@dataclass(slots=True)
class _Retry:
    pause_s: float
    at_s: float


class Reconciliation:
    """Periodic repair in a separate thread.

    is_measuring : whether a Run is being written, or soon may be
    """

    def __init__(
        self,
        context: JobContext,
        is_measuring: Callable[[], bool],
        *,
        every_s: float = EVERY_S,
    ) -> None:
        self._context, self._is_measuring = context, is_measuring
        self._every_s, self._retries = every_s, dict[str, _Retry]()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="reconciliation")

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def close(self) -> None:
        """Stop the thread; a Run being read is read to its end."""
        self._closing.set()
        if self._thread.is_alive():
            host_clock.join(self._thread)

    def repair(self) -> None:
        """Repair now, except for recent failures. Raises nothing."""
        if self._is_measuring():
            return
        now_s = host_clock.now_s()
        waiting = {i for i, retry in self._retries.items() if retry.at_s > now_s}
        try:
            failed = reconcile(self._context, skip=waiting, most=MOST_RUNS)
        except StorageUnavailable as error:
            log.warning("files and catalogue are not reconciled", reason=str(error))
            return
        except Exception:
            log.exception("files and catalogue are not reconciled")
            return
        for run_id, why in failed.items():
            self._put_off(run_id, why)

    def _put_off(self, run_id: str, why: str) -> None:
        before = self._retries.get(run_id)
        if before is None:
            log.warning("a Run on disk cannot be catalogued", run_id=run_id, why=why)
        pause_s = self._every_s if before is None else 2 * before.pause_s
        pause_s = min(pause_s, LONGEST_PAUSE_S)
        self._retries[run_id] = _Retry(pause_s, host_clock.now_s() + pause_s)

    def _run(self) -> None:
        while not host_clock.wait(self._closing, self._every_s):
            self.repair()
