"""The jobs under way and their threads."""

from __future__ import annotations

import threading
import time

from truepath.app.errors import IllegalTransition
from truepath.app.jobs.active_job import ActiveJob
from truepath.app.jobs.context import JobContext
from truepath.app.jobs.ended_measurement import catalogue_runs
from truepath.app.jobs.event_bus import EventBus
from truepath.app.jobs.job import Job
from truepath.app.jobs.transitions import Verb, apply_verb
from truepath.app.jobs.workflow import run_job


class JobsUnderWay:
    """The jobs under way, for any thread; no lock is held while one is stored.

    is_closing : whether no job is begun any more
    """

    def __init__(self, context: JobContext, event_bus: EventBus) -> None:
        self._context, self._event_bus = context, event_bus
        self._lock = threading.Lock()
        self._active: dict[str, ActiveJob] = {}
        self._threads: list[threading.Thread] = []
        self.is_closing = False

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self._active)

    def get(self, job_id: str) -> ActiveJob | None:
        """Return a job at once; None if it is not under way."""
        return self._active.get(job_id)

    def list_all(self) -> list[ActiveJob]:
        """Return all of them."""
        return list(self._active.values())

    def require(self, job_id: str, verb: Verb) -> ActiveJob:
        """Return a job to apply a verb to. Raises NotFound, IllegalTransition."""
        active = self._active.get(job_id)
        if active is not None:
            return active
        job = self._context.store.get(job_id)
        apply_verb(verb, job.state)
        raise IllegalTransition(f"cannot {verb} a job that is not under way any more")

    def begin(self, job: Job) -> None:
        """Give a job a thread of its own, unless the service ends."""
        active = ActiveJob(job, self._context.store, self._event_bus)
        name = f"job-{job.id[-6:]}"
        thread = threading.Thread(target=self._work, args=(job, active), name=name)
        with self._lock:
            if self.is_closing:
                return  # the next start finds it queued and marks it as interrupted
            self._active[job.id] = active
            self._threads = [t for t in self._threads if t.is_alive()] + [thread]
            thread.start()

    def interrupt_all(self) -> None:
        """Begin no more, and end those under way because the service ends."""
        with self._lock:
            self.is_closing = True
            under_way = list(self._active.values())
        for active in under_way:
            active.interrupt()

    def join(self, deadline_s: float) -> None:
        """Wait for their threads, until a time of the monotonic clock."""
        with self._lock:
            threads = list(self._threads)
        for thread in threads:
            thread.join(max(0.0, deadline_s - time.monotonic()))

    def _work(self, job: Job, active: ActiveJob) -> None:
        """Body of a job's thread."""
        try:
            run_job(job, active, self._context)
            if job.kind.measures:
                catalogue_runs(job, self._context)
            if job.kind.analyses and job.machine and self._context.calibrations:
                self._context.calibrations.judge(job.machine)
        finally:
            with self._lock:  # acknowledged meanwhile, it has another thread
                if self._active.get(job.id) is active:
                    del self._active[job.id]
