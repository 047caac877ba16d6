"""What a job does, written once from top to bottom.

Plan, measure, align, estimate, report. The job's thread runs it; at the checkpoints of
its `Control` it ends early.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import structlog

from app.errors import MeasurementFailed
from app.jobs.active_job import ActiveJob
from app.jobs.cell_supervisor import CellSupervisor
from app.jobs.errors import NoMachine, StorageUnavailable
from app.jobs.executor import Executor, Task
from app.jobs.growth import Growth
from app.jobs.job import Failure, Job, JobKind, Json, Progress, Stage
from app.jobs.live_estimation import LiveEstimation, Show
from app.jobs.live_process import LiveOrder
from app.jobs.measuring import CONFIRM_S, Measuring
from app.jobs.models import model_file
from app.jobs.outcome import classify_error
from app.jobs.plan_orders import first_part, plan_measurement
from app.jobs.plans import commanded_from_plan, plan_json
from app.jobs.runs import RunCatalogue
from app.jobs.science import discover_recorded
from app.jobs.store import Store
from app.jobs.transitions import State, Verb
from app.jobs.workers import Workers
from app.kinematics.machine import Machine
from app.measurement.cell import Order
from app.motion.configurations import Commanded
from app.motion.paths import check_travel

TRY_AGAIN_S = 0.5

log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class JobContext:
    """What every job works with.

    machine, cell : None where the service drives no machine
    planner : task `(machine, order, *, on_progress)` that returns the plan as JSON
    science : task `(run_files, folder, perpendicular_only, monte_carlo, workers,
        model_file, model_id, *, on_progress)`
    discoverer : task `(run_files, folder, model_file, model_id, *, on_progress)`
    workers : who computes what science can cut into blocks
    results : folder of results, one folder a job
    live : makes what estimates while the machine moves; None for no such thing
    """

    store: Store
    runs: RunCatalogue
    results: Path
    executor: Executor
    science: Task
    workers: Workers = field(default_factory=Workers)
    machine: Machine | None = None
    cell: CellSupervisor | None = None
    confirm_s: Mapping[State, float] | None = None
    live: Callable[[LiveOrder, Show], LiveEstimation] | None = None
    planner: Task = plan_measurement
    discoverer: Task = discover_recorded


def run_job(job: Job, active: ActiveJob, context: JobContext) -> None:
    """Do a job to its end and put down how it ended. Raises nothing."""
    with structlog.contextvars.bound_contextvars(job_id=job.id):
        log.info("job begins", kind=str(job.kind))
        try:
            if job.kind is JobKind.PLAN:
                plan(job, active, context)
            else:
                run_ids = job.run_ids
                if job.kind.measures:
                    run_ids = (*run_ids, measure(job, active, context))
                conclude = discover if job.kind.discovers else analyse
                conclude(job, run_ids, active, context)
        except Exception as error:
            _end(active, *classify_error(error))
        else:
            _end(active, State.SUCCEEDED)


def plan(job: Job, active: ActiveJob, context: JobContext) -> None:
    """Choose what to drive, or the first part of it, and keep it with the job."""
    if context.machine is None:
        raise NoMachine("no machine is set up; give the service a machine_file")
    state = State.PREPARING if job.kind.measures else State.RUNNING
    order = _order(job, context)
    if job.kind is JobKind.MEASURE_ADAPTIVE:
        order = first_part(context.machine, order)
    begins = state, Stage.PLANNING
    planned = _computed(
        active, context, begins, context.planner, context.machine, order
    )
    context.store.keep_plan(job.id, planned)


def measure(job: Job, active: ActiveJob, context: JobContext) -> str:
    """Drive the machine along the job's plan; return the Run that came of it."""
    if context.machine is None or context.cell is None:
        raise NoMachine("no machine is set up; give the service a machine_file")
    active.enter(State.PREPARING, Stage.PLANNING)
    if job.kind is JobKind.MEASURE_ADAPTIVE:
        plan(job, active, context)
    commanded = commanded_from_plan(context.store.plan(job.id) or {})
    check_travel(context.machine, commanded)
    context.cell.connect()
    active.checkpoint()

    active.enter(State.READY, Stage.MEASURING)
    active.wait_until_armed()

    live = _live_estimation(job, active, context, commanded)
    order = Order(
        run_name=f"{context.machine.name} {job.created}",
        run_file=str(context.runs.measured_file(job.id)),
        machine=context.machine,
        commanded=commanded,
        rate_hz=context.machine.tracker.rate_hz,
        live=live is not None,
        grows=job.kind is JobKind.MEASURE_ADAPTIVE,
    )
    try:
        Measuring(
            active,
            context.cell,
            confirm_s=context.confirm_s or CONFIRM_S,
            live=live,
            target_um=job.target_um,
            growth=_growth(job, active, context, commanded, live),
        ).run(order)
        if live is not None:
            live.finish()
    finally:
        if live is not None:
            live.close()
        _keep_run(job.id, active, context)
    return job.id


def _live_estimation(
    job: Job, active: ActiveJob, context: JobContext, commanded: Commanded
) -> LiveEstimation | None:
    """Start the live estimate. The measurement goes on without it if need be.

    A few extra lines on their own would tell little of the machine.
    """
    if (
        context.live is None
        or context.machine is None
        or job.kind is JobKind.MEASURE_EXTRA
    ):
        return None
    order = LiveOrder(
        context.machine, commanded, job.perpendicular_only, _order(job, context)
    )
    live = context.live(order, active.publish_estimate)
    try:
        live.start()
    except OSError:
        log.exception("no live estimate")
        return None
    return live


def _growth(
    job: Job,
    active: ActiveJob,
    context: JobContext,
    commanded: Commanded,
    live: LiveEstimation | None,
) -> Growth | None:
    """Return what goes on with further parts, None for a job that is planned whole."""
    if job.kind is not JobKind.MEASURE_ADAPTIVE:
        return None
    if live is None or context.cell is None:
        raise MeasurementFailed("an adaptive measurement needs its live estimate")

    def told(rows: Commanded, part: Mapping[str, Any]) -> None:
        active.publish_plan(part)
        try:
            context.store.keep_plan(job.id, plan_json(rows))
        except StorageUnavailable:
            log.exception("the grown plan is not kept; the Run holds it")

    return Growth(live, commanded, context.cell.extend, context.cell.conclude, told)


def analyse(
    job: Job, run_ids: Sequence[str], active: ActiveJob, context: JobContext
) -> None:
    """Turn Runs into error tables."""
    how = job.perpendicular_only, job.monte_carlo, context.workers
    _conclude(job, run_ids, active, context, Stage.ALIGNING, context.science, *how)


def discover(
    job: Job, run_ids: Sequence[str], active: ActiveJob, context: JobContext
) -> None:
    """Find what a model of Runs lacks: one of ours, or the one fitted to them."""
    _conclude(job, run_ids, active, context, Stage.DISCOVERING, context.discoverer)


def _conclude(
    job: Job,
    run_ids: Sequence[str],
    active: ActiveJob,
    context: JobContext,
    stage: Stage,
    task: Task,
    *how: object,
) -> None:
    """Let a task make its files of Runs and, where the job names one, of a model."""
    files = [str(context.runs.file(run_id)) for run_id in run_ids]
    folder, begins = str(context.results / job.id), (State.RUNNING, stage)
    model = _model(job, context)
    _computed(active, context, begins, task, files, folder, *how, *model)


def _model(job: Job, context: JobContext) -> tuple[str | None, str | None]:
    """Return file and identifier of the model that a job rests on, if it does."""
    model_id = context.store.plan_request(job.id).get("model_id")
    if model_id is None:
        return None, None
    return str(model_file(context.results, model_id)), model_id


def _order(job: Job, context: JobContext) -> Json:
    """Return what is asked of a plan, with the file of the model it rests on."""
    file, _ = _model(job, context)
    return {**context.store.plan_request(job.id), "model_file": file}


def _computed(
    active: ActiveJob,
    context: JobContext,
    begins: tuple[State, Stage],
    task: Task,
    *arguments: object,
) -> Any:
    """Return what the executor makes of a task; report, and end when called off.

    begins : state and stage once it is computed
    """

    def report(fraction: float, stage: str) -> None:
        active.report_progress(Progress(fraction, 1.0), stage=_stage(stage))

    def started() -> None:
        active.enter(*begins)

    computation = context.executor.submit(
        task, *arguments, on_progress=report, started=started
    )
    found = active.compute(computation)
    active.checkpoint()
    return found


def _keep_run(run_id: str, active: ActiveJob, context: JobContext) -> None:
    """Catalogue what was recorded, whole or not."""
    try:
        record = context.runs.add_measured(run_id)
    except Exception:
        # How the measurement ended is more than what became of its file.
        log.exception("the Run cannot be read; its file is kept")
        return
    if record is not None:
        active.link_run(record.id)


def _stage(name: str) -> Stage | None:
    try:
        return Stage(name)
    except ValueError:
        return None


def _end(active: ActiveJob, state: State, failure: Failure | None = None) -> None:
    """Put down the end, as soon as the catalogue takes it."""
    while True:
        try:
            if state is State.ABORTED:
                active.apply_verb(Verb.ABORT)
            job = active.end(state, failure)
        except StorageUnavailable:
            log.exception("the end of the job cannot be put down yet")
            if active.is_cancelled:  # the next start of the service will find it
                return
            time.sleep(TRY_AGAIN_S)
        else:
            log.info("job ended", state=str(job.state), reason=failure)
            return
