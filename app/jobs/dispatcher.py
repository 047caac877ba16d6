"""Accepts jobs and verbs from users. Waits for no motion; abort comes first."""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import replace

import structlog

from truepath.app.errors import IllegalTransition
from truepath.app.jobs.aborting import write_aborts
from truepath.app.jobs.arm_tokens import ArmTokens
from truepath.app.jobs.arming import Arming, list_commanded
from truepath.app.jobs.arming_rules import (
    make_purpose,
    prepare_arming,
    require_control,
    require_order,
)
from truepath.app.jobs.context import JobContext
from truepath.app.jobs.ended_measurement import interrupt_job
from truepath.app.jobs.errors import CellDown, QueueFull
from truepath.app.jobs.event_bus import EventBus
from truepath.app.jobs.idempotency import IdempotencyKey
from truepath.app.jobs.job import Job
from truepath.app.jobs.job_changes import require_version
from truepath.app.jobs.jobs_under_way import JobsUnderWay
from truepath.app.jobs.live_notice import OnNotice
from truepath.app.jobs.pausing import pause
from truepath.app.jobs.reconciliation import reconcile
from truepath.app.jobs.requested_job import RequestedJob, check_requested_job
from truepath.app.jobs.restart import leave_end, put_back
from truepath.app.jobs.resumability import (
    require_machine_file,
    require_resumable,
    require_targets_apart,
)
from truepath.app.jobs.transitions import State, Verb, apply_verb
from truepath.app.measurement.messages import CellVerb

log = structlog.get_logger(__name__)

MAX_WAITING = 100


class Dispatcher:
    """Takes on jobs and obeys verbs, for any thread."""

    def __init__(
        self,
        context: JobContext,
        event_bus: EventBus,
        arm_tokens: ArmTokens | None = None,
    ) -> None:
        self._context, self._arm_tokens = context, arm_tokens or ArmTokens()
        self._under_way = JobsUnderWay(context, event_bus)

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
        """Return a stored job with what could not be stored of it since."""
        active = self._under_way.get(job.id)
        return job if active is None else active.show(job)

    def find_machine(self, job_id: str) -> str | None:
        """Return the machine of a job under way, at once; None for any other."""
        active = self._under_way.get(job_id)
        return None if active is None else active.job.machine

    def find_controller(self, job_id: str | None) -> str | None:
        """Return who may arm and resume a job under way; None where anybody may."""
        active = self._under_way.get(job_id or "")
        return None if active is None else active.controller

    @property
    def is_measuring(self) -> bool:
        """Whether a job under way measures, or is about to."""
        return any(active.kind.measures for active in self._under_way.list_all())

    def create(
        self,
        request: RequestedJob,
        key: IdempotencyKey | None = None,
        *,
        owner: str | None = None,
    ) -> tuple[Job, bool]:
        """Take a job on; False if this key has made it before.

        owner : name of the user who asks for it

        Raises BadInput, NotFound, CellBusy, KeyReused, NoMachine, QueueFull.
        """
        earlier = self._context.store.find_by_key(key) if key is not None else None
        if earlier is not None:
            return earlier, False
        new, plan = check_requested_job(request, self._context)
        if self._under_way.is_closing:
            raise CellDown("the service is ending")
        if len(self._under_way) >= MAX_WAITING:
            raise QueueFull(f"{MAX_WAITING} jobs are under way already")
        job, is_new = self._context.store.create(replace(new, owner=owner), key, plan)
        if is_new:
            self._under_way.begin(job)
        return job, is_new

    def prepare_arming(self, job_id: str, *, by: str | None = None) -> Arming:
        """Return what a job that waits to be armed will do, and a token to arm it.

        by : name of the user who asks; None where nobody logs in

        Raises IllegalTransition, NotInControl.
        """
        active = self._under_way.require(job_id, Verb.ARM)
        require_control(active, by)
        return prepare_arming(job_id, self._context, self._arm_tokens, by)

    def arm(
        self, job_id: str, version: int, token: str, *, by: str | None = None
    ) -> Job:
        """Let a ready job move the machine.

        token : of `prepare_arming`; by : as there

        Raises StaleVersion, IllegalTransition, NotInOrder, NotInControl,
        ArmTokenExpired, ArmTokenUsed, ArmTokenOther.
        """
        active = self._under_way.require(job_id, Verb.ARM)
        require_control(active, by)
        job = self._context.store.get(job_id)
        apply_verb(Verb.ARM, job.state)
        require_version(job, version)
        require_order(job, self._context)
        parts = list_commanded(self._context.store.read_plan(job_id))
        purpose = make_purpose(job, parts, self._context, by)
        self._arm_tokens.use(token, purpose)
        job = active.apply_verb(Verb.ARM, version)
        active.arm(purpose.plan_sha256)
        return job

    def pause(self, job_id: str) -> Job:
        """Hold the feed. Raises IllegalTransition where nothing can move.

        The cell is asked even where StorageUnavailable is raised.
        """
        active = self._under_way.require(job_id, Verb.PAUSE)
        if active.state is State.RUNNING and not active.may_move:
            raise IllegalTransition(
                f"cannot pause a job that is {active.stage}: nothing moves any more"
            )
        return pause(active, self._context.machines.choose(active.job.machine).cell)

    def take_control(self, job_id: str, by: str | None) -> tuple[Job, str | None]:
        """Let only this user arm and resume a job; also return who could before.

        Raises IllegalTransition where the job is not under way.
        """
        active = self._under_way.get(job_id)
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
        """Go on after a hold.

        then : what to do first about the newest notice; by : as in `arm`

        Raises StaleVersion, IllegalTransition, NotInOrder, NotInControl.
        """
        active = self._under_way.require(job_id, Verb.RESUME)
        require_control(active, by)
        if self._context.store.get(job_id).state is State.PAUSED:
            require_order(active.job, self._context)
        job = active.apply_verb(Verb.RESUME, version)
        if then is not OnNotice.NOTE:
            active.wish(then)
        if job.state is State.RESUMING:
            self._command_cell(job, CellVerb.RESUME)
        return job

    def cancel(self, job_id: str) -> Job:
        """End a job in order; a measurement finishes the line or point under way.

        One that is held ends where it stands. Raises IllegalTransition while aborting.
        """
        active = self._under_way.get(job_id)
        if active is None:
            job = self._context.store.get(job_id)
            apply_verb(Verb.CANCEL, job.state)
            return job
        job = active.apply_verb(Verb.CANCEL)
        if job.state is State.CANCELLING:
            active.cancel()
        return job

    def acknowledge(self, job_id: str, *, by: str | None = None) -> Job:
        """Prepare a measurement that was cut short to go on.

        It then waits to be armed, by whoever has acknowledged it; nothing moves.
        Raises IllegalTransition, NotResumable (MachineFileChanged), CellBusy, NotFound.
        """
        job = self._context.store.get(job_id)
        if apply_verb(Verb.ACKNOWLEDGE, job.state) is job.state:
            return job
        plan = self._context.store.read_plan(job_id)
        require_resumable(job, plan)
        driven = self._context.machines.choose(job.machine)  # it may have gone
        require_machine_file(job, driven, self._context.registry)
        require_targets_apart(plan, driven.machine)
        if self._under_way.is_closing:
            raise CellDown("the service is ending")
        job = self._context.store.change(
            job_id, lambda ended: leave_end(ended, driven.version), version=job.version
        )
        self._under_way.begin(job)
        active = self._under_way.get(job_id)
        if active is not None and by is not None:
            active.controller = by
        return job

    def abort(self, job_id: str) -> Job:
        """End a job now. Never refused; a job that has ended stays as it is."""
        active = self._under_way.get(job_id)
        if active is None:
            return self._context.store.get(job_id)
        active.abort()
        if active.kind.measures:
            self._command_cell(active.job, CellVerb.ABORT)
        return write_aborts([active])[0]

    def stop(self, machine_id: str | None = None) -> list[Job]:
        """Stop all motion, whichever job it belongs to, and those jobs with it.

        machine_id : of the one machine to stop; without it all are. Raises NotFound.
        """
        machines = self._context.machines
        chosen = [machines.get(machine_id)] if machine_id else machines.list_all()
        for one in chosen:
            one.cell.send(CellVerb.ABORT)
        under_way = [
            active
            for active in self._under_way.list_all()
            if active.kind.measures and machine_id in (None, active.job.machine)
        ]
        for active in under_way:
            active.abort()
        return write_aborts(under_way)

    def close(self, timeout_s: float = 5.0) -> None:
        """Stop motion, end every job as interrupted, wait for their threads."""
        self._under_way.interrupt_all()
        cells = [one.cell for one in self._context.machines.list_all()]
        stopped = [cell.send(CellVerb.ABORT) for cell in cells]
        deadline = time.monotonic() + timeout_s
        for one in stopped:
            with suppress(CellDown, TimeoutError):
                one.result(max(0.0, deadline - time.monotonic()))
        self._under_way.join(deadline)

    def _begin_again(self, job: Job) -> None:
        """Queue a job that computes again; what it had begun is begun anew."""
        queued = self._context.store.change(job.id, put_back, version=job.version)
        log.info("job found unfinished", job_id=job.id, was=str(job.state))
        if not queued.is_final:
            self._under_way.begin(queued)

    def _command_cell(self, job: Job, verb: CellVerb) -> None:
        self._context.machines.choose(job.machine).cell.send(verb)
