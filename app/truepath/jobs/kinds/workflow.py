"""The steps of each kind of job, from top to bottom.

The job's thread runs them. At the checkpoints of its `ActiveJob` it ends early.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import structlog

from truepath.answers.history.model_history import RESULT, find_model_file
from truepath.catalogue.errors import (
    Aborted,
    Cancelled,
    CellDown,
    Interrupted,
    LineUnfinished,
    MachineFault,
    MeasurementEnded,
    StorageUnavailable,
    TaskFailed,
)
from truepath.catalogue.job import Failure, Job, JobKind, Json, Progress, Stage
from truepath.catalogue.transitions import State
from truepath.errors import TruepathError
from truepath.files.bundle.commanded_file import decode_commanded_json
from truepath.files.bundle.workspace_file import workspace_from_json
from truepath.jobs.kinds.motion_workflow import DrivingSteps
from truepath.jobs.kinds.station_steps import StationSteps, begin_at_station
from truepath.jobs.running.active_job import ActiveJob
from truepath.jobs.running.arming import (
    assess_approach,
    assess_path,
    hash_commanded,
    list_commanded,
)
from truepath.jobs.running.context import JobContext
from truepath.jobs.running.live_estimation import add_to_result
from truepath.jobs.running.plan_requests import request_first_part
from truepath.jobs.running.resumption import ResumedSteps, Resumption
from truepath.jobs.workers.executor import OfUnchangedRuns, Task
from truepath.jobs.workers.reanalysis import Reanalysis, list_orders, write_summary
from truepath.machines.conditions import NO_JOB
from truepath.motion.configurations import Commanded
from truepath.motion.workspace.travel import check_travel
from truepath_drivers import host_clock
from truepath_drivers.interfaces.errors import DeviceError

log = structlog.get_logger(__name__)

TRY_AGAIN_S = 0.5
TRY_AGAIN = (
    "Clear the cause, then acknowledge the job again; nothing has moved, and what was "
    "recorded is kept."
)


def run_job(job: Job, active: ActiveJob, context: JobContext) -> None:
    """Run a job to its end and store its final state. Raises nothing."""
    with structlog.contextvars.bound_contextvars(job_id=job.id):
        log.info("job begins", kind=str(job.kind))
        state, failure = State.SUCCEEDED, None
        try:
            _JobSteps(job, active, _choose_machine(job, context)).run()
        except Exception as error:
            cause = _find_cause(error, active)
            if isinstance(cause, Interrupted) and not job.kind.measures:
                _put_back(active)
                return
            state, failure = _classify_error(cause)
        if failure is not None and _can_be_tried_again(job, active, state):
            state, failure = State.FAULTED, replace(failure, action=TRY_AGAIN)
        _store_end(active, state, failure)


def _choose_machine(job: Job, context: JobContext) -> JobContext:
    return context if job.machine is None else context.of_machine(job.machine)


def _put_back(active: ActiveJob) -> None:
    try:
        active.requeue()
    except StorageUnavailable as error:  # the next start of the service will find it
        log.warning("the job cannot be queued again yet", reason=str(error))


def _find_cause(error: Exception, active: ActiveJob) -> Exception:
    """An error raised while a job is cancelled counts as the cancelling."""
    if isinstance(error, TruepathError | DeviceError):
        return error
    try:
        active.checkpoint()
    except (Aborted, Cancelled, Interrupted) as cancelled:
        log.warning("job cancelled", reason=repr(error))
        return cancelled
    return error


def _classify_error(error: Exception) -> tuple[State, Failure | None]:
    family, text = type(error).__name__, str(error)
    match error:
        case Aborted():
            return State.ABORTED, None
        case Cancelled():
            return State.CANCELLED, None
        case Interrupted():
            return State.INTERRUPTED, Failure(family, text)
        case LineUnfinished():
            return State.ABORTED, Failure(family, text, error.code, error.action)
        case MeasurementEnded():
            state = State.FAULTED if isinstance(error, MachineFault) else State.FAILED
            return state, Failure(family, text, error.code, error.action)
        case TaskFailed():
            log.warning("task failed", trace=error.trace)
            return State.FAILED, Failure(error.family, error.text)
    if not isinstance(error, TruepathError | DeviceError):
        log.error("job failed unexpectedly", exc_info=error)
    return State.FAILED, Failure(family, text)


def _can_be_tried_again(job: Job, active: ActiveJob, state: State) -> bool:
    goes_on = job.kind.measures and job.started is not None
    unarmed = active.state in (State.PREPARING, State.READY)
    return state is State.FAILED and goes_on and unarmed


def _store_end(active: ActiveJob, state: State, failure: Failure | None) -> None:
    while True:
        try:
            job = active.end(state, failure)
        except StorageUnavailable:
            if active.is_interrupted:
                active.discard_pending_end()
                return
            host_clock.sleep_s(TRY_AGAIN_S)
        else:
            log.info("job ended", state=str(job.state), reason=failure)
            return


@dataclass(frozen=True, slots=True)
class _JobSteps:
    job: Job
    active: ActiveJob
    context: JobContext

    def run(self) -> None:
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
        if job.kind.analyses:
            how = job.perpendicular_only, job.monte_carlo, context.workers
            self._conclude(run_ids, Stage.ALIGNING, context.science, *how)
        if job.kind.discovers:
            self._conclude(run_ids, Stage.DISCOVERING, context.discoverer)
        if job.kind is JobKind.TREND:
            self._follow()
        if job.kind is JobKind.REANALYSE:
            self._reanalyse()
        if job.kind is JobKind.VERIFY:
            self._verify(run_ids)

    def _plan(self) -> None:
        state = State.PREPARING if self.job.kind.measures else State.RUNNING
        machine, order = self.context.require_machine(), self._plan_request()
        if self._is_adaptive:
            order = request_first_part(machine, order)
        planner = self.context.planner
        plan = self._compute(state, Stage.PLANNING, planner, machine, order)
        self.context.store.store_plan(self.job.id, plan)

    def _prepare_rest(self) -> None:
        plan = self.context.store.read_plan(self.job.id) or {}
        steps = self._station_steps if "stations" in plan else self._resumed_steps
        steps.prepare()

    def _wait_until_armed(self) -> Commanded:
        plan = self.context.store.read_plan(self.job.id) or {}
        commanded = decode_commanded_json(plan)
        check_travel(self.context.require_machine(), commanded)
        self.context.require_cell().connect()
        self.active.checkpoint()
        begin_at_station(self.active, self.context.store)
        parts = list_commanded(plan)
        self._show_path(parts)
        self._monitor_tracker()
        self.active.enter(State.READY, Stage.MEASURING)
        try:
            self.active.wait_until_armed(hash_commanded(parts), self._monitor_tracker)
        finally:
            self._show_path(())
        return commanded

    def _show_path(self, parts: Sequence[Commanded]) -> None:
        driven = self.context.driven or self.context.machines.choose(None)
        if driven.conditions is None:
            return
        order = self._plan_request()
        workspace = workspace_from_json(order.get("workspace") or {})
        machine, board = driven.machine, driven.conditions
        if parts:
            board.assess_approach = partial(assess_approach, machine, parts, workspace)
        board.path = assess_path(machine, parts, workspace) if parts else NO_JOB
        asked = {"on": True, "off": False}.get(order.get("control_compensation", ""))
        board.wants_compensation = asked if parts else None

    def _monitor_tracker(self) -> None:
        driven = self.context.driven or self.context.machines.choose(None)
        if driven.conditions is None:
            return
        machine = driven.machine
        rate_hz, aims = machine.tracker.rate_hz, len(machine.targets) > 1
        with suppress(CellDown):  # that is a separate condition
            driven.cell.monitor_tracker_at_rest(rate_hz, aims=aims)

    def _measure_all(self, commanded: Commanded) -> tuple[str, ...]:
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
            run_id = self._resumed_steps.start_over()
        order = self._plan_request()
        continuation = (0, ()) if resumption is None else resumption.continuation
        steps = DrivingSteps(
            job, self.active, self.context, order, run_id, *continuation
        )
        steps.run(commanded)
        return tuple(dict.fromkeys((*before, run_id)))

    def _conclude(
        self, run_ids: Sequence[str], stage: Stage, task: Task, *how: object
    ) -> None:
        files, task = self._name_files(run_ids), self._guard(task, run_ids)
        folder = str(self.context.results / self.job.id)
        model = self._find_model()
        verdict = self._compute(State.RUNNING, stage, task, files, folder, *how, *model)
        notices = self.context.store.get(self.job.id).notices
        add_to_result(Path(folder) / RESULT, notices)
        self.active.store_values(verdict=verdict)

    def _follow(self) -> None:
        context, job = self.context, self.job
        files = self._name_files(job.run_ids)
        names = [context.runs.get(run_id).name for run_id in job.run_ids]
        asked = context.store.read_plan_request(job.id)
        inputs = files, names, str(context.results / job.id), asked
        follower = self._guard(context.follower, job.run_ids)
        verdict = self._compute(State.RUNNING, Stage.ESTIMATING, follower, *inputs)
        self.active.store_values(verdict=verdict)

    def _reanalyse(self) -> None:
        context, job = self.context, self.job
        folder = context.results / job.id
        orders = list_orders(
            context.store.read_plan_request(job.id)["run_ids"],
            folder,
            runs=context.runs,
            store=context.store,
            results=context.results,
        )
        reanalysis = Reanalysis(
            context.executor,
            context.reanalyser,
            orders,
            (job.perpendicular_only,),
            started=lambda: self.active.enter(State.RUNNING, Stage.ESTIMATING),
            report=self.active.report_progress,
        )
        outcomes = self.active.compute(reanalysis)
        self.active.checkpoint()
        # Where all was done before the service ended, no task has begun.
        self.active.enter(State.RUNNING, Stage.ESTIMATING)
        write_summary(folder, outcomes)

    def _verify(self, run_ids: Sequence[str]) -> None:
        context, job = self.context, self.job
        asked = context.store.read_plan_request(job.id)
        result_id, files = asked["result_id"], asked.get("compensation_id")
        kept = context.results / result_id / "compensations"
        parts = (context.store.read_plan(job.id) or {}).get("parts", ())
        first_row = {part["run_id"]: part["first_row"] for part in parts}
        inputs = (
            self._name_files(run_ids),
            [first_row.get(run_id, 0) for run_id in run_ids],
            str(context.results / job.id),
            str(find_model_file(context.results, result_id)),
            None if files is None else str(kept / files),
            asked,
        )
        verifier = self._guard(context.verifier, run_ids)
        verdict = self._compute(State.RUNNING, Stage.ALIGNING, verifier, *inputs)
        self.active.store_values(verdict=verdict)

    def _name_files(self, run_ids: Sequence[str]) -> list[str]:
        return [str(self.context.runs.file(run_id)) for run_id in run_ids]

    def _guard(self, task: Task, run_ids: Sequence[str]) -> Task:
        digests = [self.context.runs.get(run_id).sha256 for run_id in run_ids]
        files = self._name_files(run_ids)
        return OfUnchangedRuns(task, dict(zip(files, digests, strict=True)))

    def _find_model(self) -> tuple[str | None, str | None]:
        model_id = self.context.store.read_plan_request(self.job.id).get("model_id")
        if model_id is None:
            return None, None
        return str(find_model_file(self.context.results, model_id)), model_id

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
            self._monitor_tracker,
            self._show_path,
        )

    @property
    def _is_adaptive(self) -> bool:
        return self.job.kind is JobKind.MEASURE_ADAPTIVE

    def _plan_request(self) -> Json:
        file, _ = self._find_model()
        request = self.context.store.read_plan_request(self.job.id)
        return {**request, "model_file": file}

    def _compute(
        self, state: State, stage: Stage, task: Task, *arguments: object
    ) -> Any:
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
