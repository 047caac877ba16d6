"""Takes jobs and verbs from users. Waits for no motion; abort goes before all else."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import structlog

from app.errors import IllegalTransition, NotFound
from app.jobs.active_job import ActiveJob
from app.jobs.errors import CellDown, NoMachine, QueueFull
from app.jobs.event_bus import EventBus
from app.jobs.extra_lines import extra_lines
from app.jobs.job import Failure, Job, JobKind, Json, NewJob, Stage
from app.jobs.models import model_file
from app.jobs.plan_orders import driven_plan, refuse_several_targets
from app.jobs.plans import Row, plan_json, plan_motion
from app.jobs.rows import IdempotencyKey
from app.jobs.transitions import PAUSE_STATES, State, Verb, apply_verb
from app.jobs.workflow import JobContext, run_job
from app.kinematics.machine import Machine
from app.numerics.adaptive_trials import TrialPlan

log = structlog.get_logger(__name__)

MAX_WAITING = 100


@dataclass(frozen=True, slots=True)
class JobRequest:
    """What a user wants done.

    run_ids : the Runs to analyse together
    rows : path or points in the columns of the bundle
    target_um : volumetric uncertainty (k = 1) at which the measurement may end
    monte_carlo : trials to hold the uncertainty of an analysis against
    plan_id : of a plan whose rows are driven
    model_id : of the job whose model or result Runs are held against, analysed with,
        or planned for
    discovery_id : of the job whose discovery asks for the extra lines to drive
    plan_request : what is asked of a plan or an adaptive measurement, as
        `plan_orders` states it
    """

    kind: JobKind
    run_ids: Sequence[str] = ()
    rows: Sequence[Row] | None = None
    feed_mm_min: float | None = None
    perpendicular_only: bool = False
    target_um: float | None = None
    monte_carlo: TrialPlan | None = None
    plan_id: str | None = None
    model_id: str | None = None
    discovery_id: str | None = None
    plan_request: Json | None = None


class Dispatcher:
    """The jobs under way. Any thread may call it.

    No lock is held while the catalogue is written: an abort never waits for one.
    """

    def __init__(self, context: JobContext, event_bus: EventBus) -> None:
        self._context, self._event_bus = context, event_bus
        self._lock = threading.Lock()
        self._active: dict[str, ActiveJob] = {}
        self._threads: list[threading.Thread] = []
        self._closing = False

    def interrupt_unfinished_jobs(self) -> None:
        """Put down what a service that ended before had left. Moves nothing."""
        for job in self._context.store.unfinished():
            self._interrupt(job)
        self._context.runs.remove_uploads()
        self._context.store.prune()

    def create(
        self, request: JobRequest, key: IdempotencyKey | None = None
    ) -> tuple[Job, bool]:
        """Take a job on; False if this key has made it before.

        Raises BadInput for a plan that must not be driven, NotFound for an unknown Run,
        CellBusy, KeyReused, NoMachine.
        """
        earlier = self._context.store.by_key(key) if key is not None else None
        if earlier is not None:
            return earlier, False
        new = self._checked(request)
        if self._closing:
            raise CellDown("the service is ending")
        if len(self._active) >= MAX_WAITING:
            raise QueueFull(f"{MAX_WAITING} jobs are under way already")
        job, is_new = self._context.store.create(new, key)
        if is_new:
            self._begin(job)
        return job, is_new

    def arm(self, job_id: str, version: int) -> Job:
        """Let a ready job move the machine. Raises StaleVersion, IllegalTransition."""
        active = self._find_active(job_id, Verb.ARM)
        job = active.apply_verb(Verb.ARM, version)
        active.arm()
        return job

    def pause(self, job_id: str) -> Job:
        """Hold the feed. Raises IllegalTransition where nothing can move.

        The cell is told even if it stands: it might go on by itself.
        """
        active = self._find_active(job_id, Verb.PAUSE)
        self._refuse_computing(self._context.store.get(job_id))
        job = active.apply_verb(Verb.PAUSE)
        if job.state in PAUSE_STATES:
            self._cell_verb(Verb.PAUSE)
        return job

    def resume(self, job_id: str, version: int) -> Job:
        """Go on after a hold. Raises StaleVersion, IllegalTransition."""
        job = self._find_active(job_id, Verb.RESUME).apply_verb(Verb.RESUME, version)
        if job.state is State.RESUMING:
            self._cell_verb(Verb.RESUME)
        return job

    def abort(self, job_id: str) -> Job:
        """End a job now. Never refused; a job that has ended stays as it is."""
        active = self._active.get(job_id)
        if active is None:
            return self._context.store.get(job_id)
        # First the machine, then the books: the catalogue may keep us waiting.
        active.abort()
        if active.kind.measures:
            self._cell_verb(Verb.ABORT)
        return active.apply_verb(Verb.ABORT)

    def stop(self) -> list[Job]:
        """Stop all motion, whichever job it belongs to, and those jobs with it."""
        self._cell_verb(Verb.ABORT)
        under_way = list(self._active.values())
        return [self.abort(c.job_id) for c in under_way if c.kind.measures]

    def close(self, timeout_s: float = 5.0) -> None:
        """Stop motion, end every job as interrupted, wait for their threads."""
        with self._lock:
            self._closing = True
            under_way, threads = list(self._active.values()), list(self._threads)
        for active in under_way:
            active.interrupt()
        stopped = self._cell_verb(Verb.ABORT)
        deadline = time.monotonic() + timeout_s
        if stopped is not None:
            with suppress(CellDown, TimeoutError):
                stopped.result(timeout_s)
        for thread in threads:
            thread.join(max(0.0, deadline - time.monotonic()))

    def _checked(self, request: JobRequest) -> NewJob:
        if request.kind is JobKind.PLAN:
            if self._context.machine is None:
                raise NoMachine("no machine is set up; give the service a machine_file")
            only, order = request.perpendicular_only, {"request": self._order(request)}
            return NewJob(request.kind, None, only, request.target_um, order)
        if not request.kind.measures:
            first, *further = [self._context.runs.get(i).id for i in request.run_ids]
            return NewJob(
                request.kind,
                first,
                request.perpendicular_only,
                plan={"request": self._order(request)},
                monte_carlo=request.monte_carlo,
                further_run_ids=tuple(further),
            )
        machine = self._context.machine
        if machine is None or self._context.cell is None:
            raise NoMachine("no machine is set up; give the service a machine_file")
        if request.kind is JobKind.MEASURE_EXTRA:
            return self._asked_for(request.discovery_id or "", machine)
        plan: dict[str, Any] = {}
        if request.kind is JobKind.MEASURE_ADAPTIVE:
            refuse_several_targets(machine, dict(request.plan_request or {}))
        elif request.plan_id is None:
            rows, feed_mm_min = request.rows, request.feed_mm_min
            plan = plan_json(plan_motion(machine, request.kind, rows, feed_mm_min))
        else:
            plan = dict(self._planned(request.plan_id, request.kind, machine))
        plan["request"] = self._order(request)
        only, target_um = request.perpendicular_only, request.target_um
        return NewJob(request.kind, None, only, target_um, plan)

    def _planned(self, plan_id: str, kind: JobKind, machine: Machine) -> Json:
        """Return the rows of a plan, checked anew against mode, machine and travel."""
        job, plan = self._context.store.get(plan_id), self._context.store.plan(plan_id)
        if job.kind is not JobKind.PLAN:
            raise NotFound(f"there is no plan {plan_id}")
        if plan is None:
            raise IllegalTransition(f"plan {plan_id} is {job.state}; it has no rows")
        return driven_plan(machine, kind, plan)

    def _asked_for(self, discovery_id: str, machine: Machine) -> NewJob:
        """Return the job that drives the extra lines and discovers in all Runs."""
        job = self._context.store.get(discovery_id)
        if not job.has_discovery:
            raise NotFound(f"job {job.id} ({job.kind}, {job.state}) has no discovery")
        model_id = self._context.store.plan_request(job.id).get("model_id")
        rows = extra_lines(machine, self._context.results / job.id, job.id)
        plan = {**rows, "request": {"model_id": model_id}}
        return NewJob(JobKind.MEASURE_EXTRA, plan=plan, further_run_ids=job.run_ids)

    def _order(self, request: JobRequest) -> dict[str, Any]:
        """Return what is asked beside the rows; a model has to be there."""
        order = dict(request.plan_request or {})
        if request.model_id is not None:
            job = self._context.store.get(request.model_id)
            model_file(self._context.results, job.id)
            order["model_id"] = job.id
        return order

    def _begin(self, job: Job) -> None:
        active = ActiveJob(job, self._context.store, self._event_bus)
        name = f"job-{job.id[-6:]}"
        thread = threading.Thread(target=self._work, args=(job, active), name=name)
        with self._lock:
            if self._closing:
                return  # the next start finds it queued and puts it down as interrupted
            self._active[job.id] = active
            self._threads = [t for t in self._threads if t.is_alive()] + [thread]
            thread.start()

    def _work(self, job: Job, active: ActiveJob) -> None:
        """Body of a job's thread."""
        try:
            run_job(job, active, self._context)
        finally:
            del self._active[job.id]

    def _find_active(self, job_id: str, verb: Verb) -> ActiveJob:
        active = self._active.get(job_id)
        if active is not None:
            return active
        job = self._context.store.get(job_id)
        apply_verb(verb, job.state)
        raise IllegalTransition(f"cannot {verb} a job that is not under way any more")

    def _interrupt(self, job: Job) -> None:
        record = None
        if job.kind.measures:
            try:
                record = self._context.runs.add_measured(job.id)
            except Exception:
                log.exception("the Run cannot be read; its file is kept")
        text = f"the service ended while the job was {job.state}"
        after = replace(
            job,
            state=State.INTERRUPTED,
            run_id=record.id if record is not None else job.run_id,
            failure=Failure("Interrupted", text),
        )
        self._context.store.change(job.id, lambda _: after, version=job.version)
        log.warning("job found unfinished", job_id=job.id, was=str(job.state))

    def _refuse_computing(self, job: Job) -> None:
        if job.state is State.RUNNING and job.stage is not Stage.MEASURING:
            raise IllegalTransition(
                f"cannot pause a job that is {job.stage}: nothing moves any more"
            )

    def _cell_verb(self, verb: Verb) -> Future[None] | None:
        cell = self._context.cell
        if cell is None:
            return None
        match verb:
            case Verb.PAUSE:
                return cell.pause()
            case Verb.RESUME:
                return cell.resume()
            case _:
                return cell.abort()
