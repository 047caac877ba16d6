"""What a job does, written once from top to bottom, and its steps.

The job's thread runs it. At the checkpoints of its `ActiveJob` it ends early.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import structlog

from truepath.app.files.commanded_file import decode_commanded_json
from truepath.app.files.workspace_file import workspace_from_json
from truepath.app.jobs.active_job import ActiveJob
from truepath.app.jobs.analysis_steps import AnalysisSteps, find_model
from truepath.app.jobs.arming import (
    hash_commanded,
    judge_approach,
    judge_path,
    list_commanded,
)
from truepath.app.jobs.conditions import NO_JOB
from truepath.app.jobs.context import JobContext
from truepath.app.jobs.driving_steps import DrivingSteps
from truepath.app.jobs.errors import CellDown, Interrupted, StorageUnavailable
from truepath.app.jobs.executor import Task
from truepath.app.jobs.job import Job, JobKind, Json, Progress, Stage
from truepath.app.jobs.job_end import (
    TRY_AGAIN,
    can_be_tried_again,
    classify_error,
    find_cause,
    store_end,
)
from truepath.app.jobs.plan_orders import order_first_part
from truepath.app.jobs.resumption import ResumedSteps, Resumption
from truepath.app.jobs.station_steps import StationSteps, begin_at_station
from truepath.app.jobs.transitions import State
from truepath.app.motion.configurations import Commanded
from truepath.app.motion.travel import check_travel

log = structlog.get_logger(__name__)


def run_job(job: Job, active: ActiveJob, context: JobContext) -> None:
    """Do a job to its end and store how it ended. Raises nothing."""
    with structlog.contextvars.bound_contextvars(job_id=job.id):
        log.info("job begins", kind=str(job.kind))
        state, failure = State.SUCCEEDED, None
        try:
            _JobSteps(job, active, _choose_machine(job, context)).run()
        except Exception as error:
            cause = find_cause(error, active)
            if isinstance(cause, Interrupted) and not job.kind.measures:
                _put_back(active)
                return
            state, failure = classify_error(cause)
        if failure is not None and can_be_tried_again(job, active, state):
            state, failure = State.FAULTED, replace(failure, action=TRY_AGAIN)
        store_end(active, state, failure)


def _choose_machine(job: Job, context: JobContext) -> JobContext:
    """Return the context with the machine of the job, where it has one."""
    return context if job.machine is None else context.of_machine(job.machine)


def _put_back(active: ActiveJob) -> None:
    try:
        active.put_back()
    except StorageUnavailable as error:  # the next start of the service will find it
        log.warning("the job cannot be queued again yet", reason=str(error))


@dataclass(frozen=True, slots=True)
class _JobSteps:
    """One job, the user's requests for it, and what it works with."""

    job: Job
    active: ActiveJob
    context: JobContext

    def run(self) -> None:
        """Plan, measure, analyse, discover, follow: as the kind of the job asks."""
        job, context, run_ids = self.job, self.context, self.job.run_ids
        if job.kind.measures:
            context.require_cell()
            self.active.enter(State.PREPARING, Stage.PLANNING)
        chooses = job.kind.measures or job.kind is JobKind.PLAN
        if chooses and context.store.read_plan(job.id) is None:
            self._plan()
        elif job.kind.measures and job.started is not None:
            self._prepare_rest()
        elif job.kind is JobKind.PLAN:  # planned before the service ended
            self.active.enter(State.RUNNING, Stage.PLANNING)
        if job.kind.measures:
            run_ids = self._measure_all(self._wait_until_armed())
        steps = AnalysisSteps(job, self.active, context, self._compute)
        if job.kind.analyses:
            how = job.perpendicular_only, job.monte_carlo, context.workers
            steps.conclude(run_ids, Stage.ALIGNING, context.science, *how)
        if job.kind.discovers:
            steps.conclude(run_ids, Stage.DISCOVERING, context.discoverer)
        if job.kind is JobKind.TREND:
            steps.follow()
        if job.kind is JobKind.REANALYSE:
            steps.reanalyse()
        if job.kind is JobKind.VERIFY:
            steps.verify(run_ids)

    def _plan(self) -> None:
        """Choose what to drive, or the first part of it, and store it with the job."""
        state = State.PREPARING if self.job.kind.measures else State.RUNNING
        machine, order = self.context.require_machine(), self._plan_order()
        if self._is_adaptive:
            order = order_first_part(machine, order)
        planner = self.context.planner
        plan = self._compute(state, Stage.PLANNING, planner, machine, order)
        self.context.store.keep_plan(self.job.id, plan)

    def _prepare_rest(self) -> None:
        """Find what is left of a measurement that was cut short."""
        plan = self.context.store.read_plan(self.job.id) or {}
        steps = self._station_steps if "stations" in plan else self._resumed_steps
        steps.prepare()

    def _wait_until_armed(self) -> Commanded:
        """Return what the user lets the machine drive, checked against its travel."""
        plan = self.context.store.read_plan(self.job.id) or {}
        commanded = decode_commanded_json(plan)
        check_travel(self.context.require_machine(), commanded)
        self.context.require_cell().connect()
        self.active.checkpoint()
        begin_at_station(self.active, self.context.store)
        parts = list_commanded(plan)
        self._show_path(parts)
        self._hear_tracker()
        self.active.enter(State.READY, Stage.MEASURING)
        try:
            self.active.wait_until_armed(hash_commanded(parts), self._hear_tracker)
        finally:
            self._show_path(())
        return commanded

    def _show_path(self, parts: Sequence[Commanded]) -> None:
        """Show what waits to be armed: how it lies, what it asks of the control."""
        driven = self.context.driven or self.context.machines.choose(None)
        if driven.conditions is None:
            return
        order = self._plan_order()
        workspace = workspace_from_json(order.get("workspace") or {})
        machine, board = driven.machine, driven.conditions
        if parts:
            board.judge_approach = partial(judge_approach, machine, parts, workspace)
        board.path = judge_path(machine, parts, workspace) if parts else NO_JOB
        asked = {"on": True, "off": False}.get(order.get("control_compensation", ""))
        board.wants_compensation = asked if parts else None

    def _hear_tracker(self) -> None:
        """Let the conditions show beam and stream, where somebody looks at them."""
        driven = self.context.driven or self.context.machines.choose(None)
        if driven.conditions is None:
            return
        machine = driven.machine
        rate_hz, aims = machine.tracker.rate_hz, len(machine.targets) > 1
        with suppress(CellDown):  # that is a condition of its own
            driven.cell.hear_tracker(rate_hz, aims=aims)

    def _measure_all(self, commanded: Commanded) -> tuple[str, ...]:
        """Measure, from every station of the plan; return the Runs to go by."""
        plan, job = self.context.store.read_plan(self.job.id) or {}, self.job
        if "stations" in plan:
            return self._station_steps.run()
        resumption, run_id, before = Resumption.read(plan), job.id, job.run_ids
        if job.started is not None:
            before = self._resumed_steps.list_kept(resumption)
        if resumption is not None:
            run_id = self._resumed_steps.begin_part(resumption, commanded)
            commanded = resumption.select_rest(commanded)
        elif job.started is not None:
            run_id = self._resumed_steps.begin_anew()
        order = self._plan_order()
        going_on = (0, ()) if resumption is None else resumption.going_on
        steps = DrivingSteps(job, self.active, self.context, order, run_id, *going_on)
        steps.run(commanded)
        return tuple(dict.fromkeys((*before, run_id)))

    @property
    def _resumed_steps(self) -> ResumedSteps:
        return ResumedSteps(self.job, self.active, self.context, self._compute)

    @property
    def _station_steps(self) -> StationSteps:
        return StationSteps(
            self.job,
            self.active,
            self.context,
            self._compute,
            self._hear_tracker,
            self._show_path,
        )

    @property
    def _is_adaptive(self) -> bool:
        return self.job.kind is JobKind.MEASURE_ADAPTIVE

    def _plan_order(self) -> Json:
        """Return what is asked of a plan, with the file of the model it builds on."""
        file, _ = find_model(self.job, self.context)
        request = self.context.store.read_plan_request(self.job.id)
        return {**request, "model_file": file}

    def _compute(
        self, state: State, stage: Stage, task: Task, *arguments: object
    ) -> Any:
        """Return what the executor computes; enter state and stage as it begins."""
        computation = self.context.executor.submit(
            task,
            *arguments,
            on_progress=self._report_progress,
            started=lambda: self.active.enter(state, stage),
        )
        found = self.active.compute(computation)
        self.active.checkpoint()
        return found

    def _report_progress(self, share: float, name: str) -> None:
        stage = Stage(name) if name in set(Stage) else None
        self.active.report_progress(Progress(share, 1.0), stage=stage)
