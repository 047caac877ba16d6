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
from app.jobs.control import Control
from app.jobs.errors import CellDown, NoMachine, QueueFull
from app.jobs.extra_lines import extra_lines
from app.jobs.feed import Feed
from app.jobs.job import Failure, Job, Json, Kind, NewJob, Stage
from app.jobs.models import model_file
from app.jobs.plan_orders import driven_plan, refuse_several_targets
from app.jobs.plans import Row, plan_json, plan_motion
from app.jobs.rows import Key
from app.jobs.transitions import HELD, State, Verb, after_verb
from app.jobs.workflow import Workshop, carry_out
from app.kinematics.machine import Machine
from app.numerics.adaptive_trials import TrialPlan

log = structlog.get_logger(__name__)

MAX_WAITING = 100


@dataclass(frozen=True, slots=True)
class Wish:
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

    kind: Kind
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

    def __init__(self, shop: Workshop, feed: Feed) -> None:
        self._shop, self._feed = shop, feed
        self._lock = threading.Lock()
        self._controls: dict[str, Control] = {}
        self._threads: list[threading.Thread] = []
        self._closing = False

    def sweep(self) -> None:
        """Put down what a service that ended before had left. Moves nothing."""
        for job in self._shop.store.unfinished():
            self._interrupt(job)
        self._shop.runs.remove_uploads()
        self._shop.store.prune()

    def create(self, wish: Wish, key: Key | None = None) -> tuple[Job, bool]:
        """Take a job on; False if this key has made it before.

        Raises BadInput for a plan that must not be driven, NotFound for an unknown Run,
        CellBusy, KeyReused, NoMachine.
        """
        earlier = self._shop.store.by_key(key) if key is not None else None
        if earlier is not None:
            return earlier, False
        new = self._checked(wish)
        if self._closing:
            raise CellDown("the service is ending")
        if len(self._controls) >= MAX_WAITING:
            raise QueueFull(f"{MAX_WAITING} jobs are under way already")
        job, is_new = self._shop.store.create(new, key)
        if is_new:
            self._begin(job)
        return job, is_new

    def arm(self, job_id: str, version: int) -> Job:
        """Let a ready job move the machine. Raises StaleVersion, IllegalTransition."""
        control = self._control(job_id, Verb.ARM)
        job = control.obey(Verb.ARM, version)
        control.arm()
        return job

    def pause(self, job_id: str) -> Job:
        """Hold the feed. Raises IllegalTransition where nothing can move.

        The cell is told even if it stands: it might go on by itself.
        """
        control = self._control(job_id, Verb.PAUSE)
        self._refuse_computing(self._shop.store.get(job_id))
        job = control.obey(Verb.PAUSE)
        if job.state in HELD:
            self._cell_verb(Verb.PAUSE)
        return job

    def resume(self, job_id: str, version: int) -> Job:
        """Go on after a hold. Raises StaleVersion, IllegalTransition."""
        job = self._control(job_id, Verb.RESUME).obey(Verb.RESUME, version)
        if job.state is State.RESUMING:
            self._cell_verb(Verb.RESUME)
        return job

    def abort(self, job_id: str) -> Job:
        """End a job now. Never refused; a job that has ended stays as it is."""
        control = self._controls.get(job_id)
        if control is None:
            return self._shop.store.get(job_id)
        # First the machine, then the books: the catalogue may keep us waiting.
        control.abort()
        if control.kind.measures:
            self._cell_verb(Verb.ABORT)
        return control.obey(Verb.ABORT)

    def stop(self) -> list[Job]:
        """Stop all motion, whichever job it belongs to, and those jobs with it."""
        self._cell_verb(Verb.ABORT)
        under_way = list(self._controls.values())
        return [self.abort(c.job_id) for c in under_way if c.kind.measures]

    def close(self, timeout_s: float = 5.0) -> None:
        """Stop motion, end every job as interrupted, wait for their threads."""
        with self._lock:
            self._closing = True
            controls, threads = list(self._controls.values()), list(self._threads)
        for control in controls:
            control.interrupt()
        stopped = self._cell_verb(Verb.ABORT)
        deadline = time.monotonic() + timeout_s
        if stopped is not None:
            with suppress(CellDown, TimeoutError):
                stopped.result(timeout_s)
        for thread in threads:
            thread.join(max(0.0, deadline - time.monotonic()))

    def _checked(self, wish: Wish) -> NewJob:
        if wish.kind is Kind.PLAN:
            if self._shop.machine is None:
                raise NoMachine("no machine is set up; give the service a machine_file")
            only, order = wish.perpendicular_only, {"request": self._order(wish)}
            return NewJob(wish.kind, None, only, wish.target_um, order)
        if not wish.kind.measures:
            first, *further = [self._shop.runs.get(i).id for i in wish.run_ids]
            return NewJob(
                wish.kind,
                first,
                wish.perpendicular_only,
                plan={"request": self._order(wish)},
                monte_carlo=wish.monte_carlo,
                further_run_ids=tuple(further),
            )
        machine = self._shop.machine
        if machine is None or self._shop.cell is None:
            raise NoMachine("no machine is set up; give the service a machine_file")
        if wish.kind is Kind.MEASURE_EXTRA:
            return self._asked_for(wish.discovery_id or "", machine)
        plan: dict[str, Any] = {}
        if wish.kind is Kind.MEASURE_ADAPTIVE:
            refuse_several_targets(machine, dict(wish.plan_request or {}))
        elif wish.plan_id is None:
            rows, feed_mm_min = wish.rows, wish.feed_mm_min
            plan = plan_json(plan_motion(machine, wish.kind, rows, feed_mm_min))
        else:
            plan = dict(self._planned(wish.plan_id, wish.kind, machine))
        plan["request"] = self._order(wish)
        only, target_um = wish.perpendicular_only, wish.target_um
        return NewJob(wish.kind, None, only, target_um, plan)

    def _planned(self, plan_id: str, kind: Kind, machine: Machine) -> Json:
        """Return the rows of a plan, checked anew against mode, machine and travel."""
        job, plan = self._shop.store.get(plan_id), self._shop.store.plan(plan_id)
        if job.kind is not Kind.PLAN:
            raise NotFound(f"there is no plan {plan_id}")
        if plan is None:
            raise IllegalTransition(f"plan {plan_id} is {job.state}; it has no rows")
        return driven_plan(machine, kind, plan)

    def _asked_for(self, discovery_id: str, machine: Machine) -> NewJob:
        """Return the job that drives the extra lines and discovers in all Runs."""
        job = self._shop.store.get(discovery_id)
        if not job.has_discovery:
            raise NotFound(f"job {job.id} ({job.kind}, {job.state}) has no discovery")
        model_id = self._shop.store.plan_request(job.id).get("model_id")
        rows = extra_lines(machine, self._shop.results / job.id, job.id)
        plan = {**rows, "request": {"model_id": model_id}}
        return NewJob(Kind.MEASURE_EXTRA, plan=plan, further_run_ids=job.run_ids)

    def _order(self, wish: Wish) -> dict[str, Any]:
        """Return what is asked beside the rows; a model has to be there."""
        order = dict(wish.plan_request or {})
        if wish.model_id is not None:
            job = self._shop.store.get(wish.model_id)
            model_file(self._shop.results, job.id)
            order["model_id"] = job.id
        return order

    def _begin(self, job: Job) -> None:
        control = Control(job, self._shop.store, self._feed)
        name = f"job-{job.id[-6:]}"
        thread = threading.Thread(target=self._work, args=(job, control), name=name)
        with self._lock:
            if self._closing:
                return  # the next start finds it queued and puts it down as interrupted
            self._controls[job.id] = control
            self._threads = [t for t in self._threads if t.is_alive()] + [thread]
            thread.start()

    def _work(self, job: Job, control: Control) -> None:
        """Body of a job's thread."""
        try:
            carry_out(job, control, self._shop)
        finally:
            del self._controls[job.id]

    def _control(self, job_id: str, verb: Verb) -> Control:
        control = self._controls.get(job_id)
        if control is not None:
            return control
        job = self._shop.store.get(job_id)
        after_verb(verb, job.state)
        raise IllegalTransition(f"cannot {verb} a job that is not under way any more")

    def _interrupt(self, job: Job) -> None:
        record = None
        if job.kind.measures:
            try:
                record = self._shop.runs.add_measured(job.id)
            except Exception:
                log.exception("the Run cannot be read; its file is kept")
        text = f"the service ended while the job was {job.state}"
        after = replace(
            job,
            state=State.INTERRUPTED,
            run_id=record.id if record is not None else job.run_id,
            failure=Failure("Interrupted", text),
        )
        self._shop.store.change(job.id, lambda _: after, version=job.version)
        log.warning("job found unfinished", job_id=job.id, was=str(job.state))

    def _refuse_computing(self, job: Job) -> None:
        if job.state is State.RUNNING and job.stage is not Stage.MEASURING:
            raise IllegalTransition(
                f"cannot pause a job that is {job.stage}: nothing moves any more"
            )

    def _cell_verb(self, verb: Verb) -> Future[None] | None:
        cell = self._shop.cell
        if cell is None:
            return None
        match verb:
            case Verb.PAUSE:
                return cell.pause()
            case Verb.RESUME:
                return cell.resume()
            case _:
                return cell.abort()
