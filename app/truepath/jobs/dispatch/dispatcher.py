"""Verbs of jobs from users. None waits for motion; abort takes precedence."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import structlog

from truepath.catalogue.errors import (
    CellDown,
    NotInControl,
    QueueFull,
    StorageUnavailable,
)
from truepath.catalogue.job import Job, OnNotice
from truepath.catalogue.job_changes import (
    reopen_measurement,
    requeue,
    require_version,
)
from truepath.catalogue.store import IdempotencyKey
from truepath.catalogue.transitions import State, Verb, apply_verb
from truepath.errors import IllegalTransition
from truepath.jobs.dispatch.reconciliation import (
    catalogue_runs,
    interrupt_job,
    reconcile,
)
from truepath.jobs.kinds.job_steps import RequestedJob
from truepath.jobs.kinds.workflow import prepare_job, run_job
from truepath.jobs.running.active_job import ActiveJob, EventBus
from truepath.jobs.running.arming import (
    Arming,
    ArmingPurpose,
    ArmTokens,
    hash_commanded,
    list_commanded,
    summarise_motion,
)
from truepath.jobs.running.context import JobContext
from truepath.jobs.running.resumption import (
    require_machine_file,
    require_resumable,
    require_targets_apart,
)
from truepath.machines.conditions import NotInOrder
from truepath.measurement.messages import CellVerb
from truepath.motion.configurations import Commanded
from truepath_drivers import host_clock

log = structlog.get_logger(__name__)

MAX_WAITING = 100
BOOKS_S = 0.7  # that a client which stops the machine waits for the catalogue


class Dispatcher:
    """Accepts jobs and verbs; thread-safe."""

    def __init__(
        self,
        context: JobContext,
        event_bus: EventBus,
        arm_tokens: ArmTokens | None = None,
    ) -> None:
        self._context, self._arm_tokens = context, arm_tokens or ArmTokens()
        self._active_jobs = _ActiveJobs(context, event_bus)

    def interrupt_unfinished_jobs(self) -> None:
        """Mark measurements that an earlier service left unfinished. Moves nothing.

        Jobs that only compute are queued again, in their order.
        """
        unfinished = self._context.store.list_unfinished()
        for job in unfinished:
            if job.kind.measures:
                interrupt_job(job, self._context)
        for run_id, why in reconcile(self._context).items():
            log.warning("a Run on disk cannot be catalogued", run_id=run_id, why=why)
        self._context.runs.remove_uploads()
        self._context.store.prune()
        for job in unfinished:
            if not job.kind.measures:
                self._begin_again(job)

    def show(self, job: Job) -> Job:
        """The stored job with newer values that could not be stored."""
        active = self._active_jobs.get(job.id)
        return job if active is None else active.show(job)

    def find_machine(self, job_id: str) -> str | None:
        """Machine of an active job; None for any other. Reads no storage."""
        active = self._active_jobs.get(job_id)
        return None if active is None else active.job.machine

    def find_controller(self, job_id: str | None) -> str | None:
        """User who may arm and resume an active job; None where any user may."""
        active = self._active_jobs.get(job_id or "")
        return None if active is None else active.controller

    @property
    def is_measuring(self) -> bool:
        """Whether an active job measures, or is about to."""
        return any(active.kind.measures for active in self._active_jobs.list_all())

    def create(
        self,
        request: RequestedJob,
        key: IdempotencyKey | None = None,
        *,
        owner: str | None = None,
    ) -> tuple[Job, bool]:
        """Accept a job; False if this key has made it before.

        owner : name of the requesting user

        Raises BadInput, NotFound, CellBusy, KeyReused, NoMachine, QueueFull.
        """
        earlier = self._context.store.find_by_key(key) if key is not None else None
        if earlier is not None:
            return earlier, False
        new, plan = prepare_job(request, self._context)
        if self._active_jobs.is_closing:
            raise CellDown("the service is ending")
        if len(self._active_jobs) >= MAX_WAITING:
            raise QueueFull(f"{MAX_WAITING} jobs are under way already")
        job, is_new = self._context.store.create(replace(new, owner=owner), key, plan)
        if is_new:
            self._active_jobs.begin(job)
        return job, is_new

    def prepare_arming(self, job_id: str, *, by: str | None = None) -> Arming:
        """Summary of a motion that waits to be armed, with a token for it.

        by : name of the requesting user; None without login

        Raises IllegalTransition, NotInControl.
        """
        active = self._active_jobs.require(job_id, Verb.ARM)
        _require_control(active, by)
        job = self._context.store.get(job_id)
        apply_verb(Verb.ARM, job.state)
        driven = self._context.machines.choose(job.machine)
        parts = list_commanded(self._context.store.read_plan(job_id))
        board, read = driven.conditions, driven.cell.controller
        here = {} if read is None else read.position_by_axis
        purpose = self._make_purpose(job, parts, by)
        return Arming(
            job,
            driven,
            summarise_motion(driven.machine, job.kind, parts, here),
            () if board is None else tuple(board.read()),
            purpose.plan_sha256,
            self._arm_tokens.issue(purpose),
            self._arm_tokens.valid_s,
        )

    def arm(
        self, job_id: str, version: int, token: str, *, by: str | None = None
    ) -> Job:
        """Let a ready job move the machine.

        token : of `prepare_arming`; by : as there

        Raises StaleVersion, IllegalTransition, NotInOrder, NotInControl,
        ArmTokenExpired, ArmTokenUsed, ArmTokenOther.
        """
        active = self._active_jobs.require(job_id, Verb.ARM)
        _require_control(active, by)
        job = self._context.store.get(job_id)
        apply_verb(Verb.ARM, job.state)
        require_version(job, version)
        self._require_conditions(job)
        parts = list_commanded(self._context.store.read_plan(job_id))
        purpose = self._make_purpose(job, parts, by)
        self._arm_tokens.use(token, purpose)
        job = active.apply_verb(Verb.ARM, version)
        active.arm(purpose.plan_sha256)
        return job

    def pause(self, job_id: str) -> Job:
        """Hold the feed. Raises IllegalTransition where nothing can move.

        The cell is asked even where StorageUnavailable is raised.
        """
        active = self._active_jobs.require(job_id, Verb.PAUSE)
        if active.state is State.RUNNING and not active.may_move:
            raise IllegalTransition(
                f"cannot pause a job that is {active.stage}: nothing moves any more"
            )
        return active.pause(self._context.machines.choose(active.job.machine).cell)

    def take_control(self, job_id: str, by: str | None) -> tuple[Job, str | None]:
        """Let only this user arm and resume a job; second value: who could before.

        Raises IllegalTransition where the job is not active.
        """
        active = self._active_jobs.get(job_id)
        job = self._context.store.get(job_id)
        if active is None or not job.kind.measures:
            raise IllegalTransition(
                f"job {job_id} ({job.kind}, {job.state}) moves nothing"
            )
        before, active.controller = active.controller, by
        log.info("control taken over", job_id=job_id, before=before, now=by)
        return job, before

    def resume(
        self,
        job_id: str,
        version: int,
        then: OnNotice = OnNotice.NOTE,
        *,
        by: str | None = None,
    ) -> Job:
        """Continue after a hold.

        then : action on the newest notice, done first; by : as in `arm`

        Raises StaleVersion, IllegalTransition, NotInOrder, NotInControl.
        """
        active = self._active_jobs.require(job_id, Verb.RESUME)
        _require_control(active, by)
        if self._context.store.get(job_id).state is State.PAUSED:
            self._require_conditions(active.job)
        job = active.apply_verb(Verb.RESUME, version)
        if then is not OnNotice.NOTE:
            active.request_notice_action(then)
        if job.state is State.RESUMING:
            self._command_cell(job, CellVerb.RESUME)
        return job

    def cancel(self, job_id: str) -> Job:
        """End a job in order; a measurement finishes its current line or point.

        One that is held ends at once. Raises IllegalTransition while aborting.
        """
        active = self._active_jobs.get(job_id)
        if active is None:
            job = self._context.store.get(job_id)
            apply_verb(Verb.CANCEL, job.state)
            return job
        job = active.apply_verb(Verb.CANCEL)
        if job.state is State.CANCELLING:
            active.cancel()
        return job

    def acknowledge(self, job_id: str, *, by: str | None = None) -> Job:
        """Prepare an interrupted measurement to resume; nothing moves.

        It then waits to be armed by the user who acknowledged it. Raises
        IllegalTransition, NotResumable (MachineFileChanged), CellBusy, NotFound.
        """
        job = self._context.store.get(job_id)
        if apply_verb(Verb.ACKNOWLEDGE, job.state) is job.state:
            return job
        plan = self._context.store.read_plan(job_id)
        require_resumable(job, plan)
        driven = self._context.machines.choose(job.machine)  # it may have gone
        require_machine_file(job, driven, self._context.registry)
        require_targets_apart(plan, driven.machine)
        if self._active_jobs.is_closing:
            raise CellDown("the service is ending")
        job = self._context.store.change(
            job_id,
            lambda ended: reopen_measurement(ended, driven.version),
            version=job.version,
        )
        self._active_jobs.begin(job)
        active = self._active_jobs.get(job_id)
        if active is not None and by is not None:
            active.controller = by
        return job

    def abort(self, job_id: str) -> Job:
        """End a job now. Never refused; a job that has ended stays as it is."""
        active = self._active_jobs.get(job_id)
        if active is None:
            return self._context.store.get(job_id)
        active.abort()
        if active.kind.measures:
            self._command_cell(active.job, CellVerb.ABORT)
        return _write_aborts([active])[0]

    def stop(self, machine_id: str | None = None) -> list[Job]:
        """Stop all motion, also motion of no job, and abort the jobs concerned.

        machine_id : only this machine; None for all. Raises NotFound.
        """
        machines = self._context.machines
        chosen = [machines.get(machine_id)] if machine_id else machines.list_all()
        for one in chosen:
            one.cell.send(CellVerb.ABORT)
        under_way = [
            active
            for active in self._active_jobs.list_all()
            if active.kind.measures and machine_id in (None, active.job.machine)
        ]
        for active in under_way:
            active.abort()
        return _write_aborts(under_way)

    def close(self, timeout_s: float = 5.0) -> None:
        """Stop motion, end every job as interrupted, wait for the threads."""
        self._active_jobs.interrupt_all()
        cells = [one.cell for one in self._context.machines.list_all()]
        stopped = [cell.send(CellVerb.ABORT) for cell in cells]
        deadline = host_clock.now_s() + timeout_s
        for one in stopped:
            with suppress(CellDown, TimeoutError):
                host_clock.result(one, max(0.0, deadline - host_clock.now_s()))
        self._active_jobs.join(deadline)

    def _begin_again(self, job: Job) -> None:
        queued = self._context.store.change(job.id, requeue, version=job.version)
        log.info("job found unfinished", job_id=job.id, was=str(job.state))
        if not queued.is_final:
            self._active_jobs.begin(queued)

    def _command_cell(self, job: Job, verb: CellVerb) -> None:
        self._context.machines.choose(job.machine).cell.send(verb)

    def _make_purpose(
        self, job: Job, parts: Sequence[Commanded], by: str | None
    ) -> ArmingPurpose:
        driven = self._context.machines.choose(job.machine)
        plan_sha256 = hash_commanded(parts)
        return ArmingPurpose(
            job.id, job.version, by, driven.id, driven.version, plan_sha256
        )

    def _require_conditions(self, job: Job) -> None:
        board = self._context.machines.choose(job.machine).conditions
        obstacles = [] if board is None else board.list_obstacles()
        if obstacles:
            raise NotInOrder(obstacles)


def _require_control(active: ActiveJob, by: str | None) -> None:
    if by is not None and active.controller not in (None, by):
        raise NotInControl(active.controller or "")


def _write_aborts(aborted: Sequence[ActiveJob]) -> list[Job]:
    """The machine is stopped already; the client is answered in time even where the
    catalogue does not respond. The jobs' own threads then store how they end.
    """
    written: dict[str, Job] = {}
    writers = [
        threading.Thread(target=_write_abort, args=(active, written), daemon=True)
        for active in aborted
    ]
    for writer in writers:
        writer.start()
    end = host_clock.now_s() + BOOKS_S
    for writer in writers:
        host_clock.join(writer, max(0.0, end - host_clock.now_s()))
    return [written.get(one.job_id) or one.show(one.job) for one in aborted]


def _write_abort(active: ActiveJob, written: dict[str, Job]) -> None:
    try:
        written[active.job_id] = active.apply_verb(Verb.ABORT)
    except StorageUnavailable as error:
        log.warning("an abort is not written down", job=active.job_id, why=error)


class _ActiveJobs:
    """No lock is held while a job is stored."""

    def __init__(self, context: JobContext, event_bus: EventBus) -> None:
        self._context, self._event_bus = context, event_bus
        self._lock = threading.Lock()
        self._active: dict[str, ActiveJob] = {}
        self._threads: list[threading.Thread] = []
        self.is_closing = False

    def __len__(self) -> int:
        return len(self._active)

    def get(self, job_id: str) -> ActiveJob | None:
        return self._active.get(job_id)

    def list_all(self) -> list[ActiveJob]:
        return list(self._active.values())

    def require(self, job_id: str, verb: Verb) -> ActiveJob:
        active = self._active.get(job_id)
        if active is not None:
            return active
        job = self._context.store.get(job_id)
        apply_verb(verb, job.state)
        raise IllegalTransition(f"cannot {verb} a job that is not under way any more")

    def begin(self, job: Job) -> None:
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
        with self._lock:
            self.is_closing = True
            under_way = list(self._active.values())
        for active in under_way:
            active.interrupt()

    def join(self, deadline_s: float) -> None:
        """Until a time of the monotonic clock."""
        with self._lock:
            threads = list(self._threads)
        for thread in threads:
            host_clock.join(thread, max(0.0, deadline_s - host_clock.now_s()))

    def _work(self, job: Job, active: ActiveJob) -> None:
        try:
            run_job(job, active, self._context)
            if job.kind.measures:
                catalogue_runs(job, self._context)
            if job.kind.analyses and job.machine and self._context.calibrations:
                self._context.calibrations.update_status(job.machine)
        finally:
            with self._lock:  # acknowledged meanwhile, it has another thread
                if self._active.get(job.id) is active:
                    del self._active[job.id]
