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
from app.jobs.cell_supervisor import CellSupervisor
from app.jobs.control import Control
from app.jobs.errors import NoMachine, StorageUnavailable
from app.jobs.executor import Executor, Task
from app.jobs.growth import Growth
from app.jobs.job import Failure, Job, Json, Kind, Progress, Stage
from app.jobs.live_estimation import LiveEstimation, Show
from app.jobs.live_process import LiveOrder
from app.jobs.measuring import CONFIRM_S, Measuring
from app.jobs.models import model_file
from app.jobs.outcome import outcome_of
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
class Workshop:
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


def carry_out(job: Job, control: Control, shop: Workshop) -> None:
    """Do a job to its end and put down how it ended. Raises nothing."""
    with structlog.contextvars.bound_contextvars(job_id=job.id):
        log.info("job begins", kind=str(job.kind))
        try:
            if job.kind is Kind.PLAN:
                plan(job, control, shop)
            else:
                run_ids = job.run_ids
                if job.kind.measures:
                    run_ids = (*run_ids, measure(job, control, shop))
                conclude = discover if job.kind.discovers else analyse
                conclude(job, run_ids, control, shop)
        except Exception as error:
            _end(control, *outcome_of(error))
        else:
            _end(control, State.SUCCEEDED)


def plan(job: Job, control: Control, shop: Workshop) -> None:
    """Choose what to drive, or the first part of it, and keep it with the job."""
    if shop.machine is None:
        raise NoMachine("no machine is set up; give the service a machine_file")
    state = State.PREPARING if job.kind.measures else State.RUNNING
    order = _order(job, shop)
    if job.kind is Kind.MEASURE_ADAPTIVE:
        order = first_part(shop.machine, order)
    begins = state, Stage.PLANNING
    planned = _computed(control, shop, begins, shop.planner, shop.machine, order)
    shop.store.keep_plan(job.id, planned)


def measure(job: Job, control: Control, shop: Workshop) -> str:
    """Drive the machine along the job's plan; return the Run that came of it."""
    if shop.machine is None or shop.cell is None:
        raise NoMachine("no machine is set up; give the service a machine_file")
    control.enter(State.PREPARING, Stage.PLANNING)
    if job.kind is Kind.MEASURE_ADAPTIVE:
        plan(job, control, shop)
    commanded = commanded_from_plan(shop.store.plan(job.id) or {})
    check_travel(shop.machine, commanded)
    shop.cell.connect()
    control.checkpoint()

    control.enter(State.READY, Stage.MEASURING)
    control.wait_until_armed()

    live = _live_estimation(job, control, shop, commanded)
    order = Order(
        run_name=f"{shop.machine.name} {job.created}",
        run_file=str(shop.runs.measured_file(job.id)),
        machine=shop.machine,
        commanded=commanded,
        rate_hz=shop.machine.tracker.rate_hz,
        live=live is not None,
        grows=job.kind is Kind.MEASURE_ADAPTIVE,
    )
    try:
        Measuring(
            control,
            shop.cell,
            confirm_s=shop.confirm_s or CONFIRM_S,
            live=live,
            target_um=job.target_um,
            growth=_growth(job, control, shop, commanded, live),
        ).run(order)
        if live is not None:
            live.finish()
    finally:
        if live is not None:
            live.close()
        _keep_run(job.id, control, shop)
    return job.id


def _live_estimation(
    job: Job, control: Control, shop: Workshop, commanded: Commanded
) -> LiveEstimation | None:
    """Start the live estimate. The measurement goes on without it if need be.

    A few extra lines on their own would tell little of the machine.
    """
    if shop.live is None or shop.machine is None or job.kind is Kind.MEASURE_EXTRA:
        return None
    order = LiveOrder(
        shop.machine, commanded, job.perpendicular_only, _order(job, shop)
    )
    live = shop.live(order, control.show_estimate)
    try:
        live.start()
    except OSError:
        log.exception("no live estimate")
        return None
    return live


def _growth(
    job: Job,
    control: Control,
    shop: Workshop,
    commanded: Commanded,
    live: LiveEstimation | None,
) -> Growth | None:
    """Return what goes on with further parts, None for a job that is planned whole."""
    if job.kind is not Kind.MEASURE_ADAPTIVE:
        return None
    if live is None or shop.cell is None:
        raise MeasurementFailed("an adaptive measurement needs its live estimate")

    def told(rows: Commanded, part: Mapping[str, Any]) -> None:
        control.show_plan(part)
        try:
            shop.store.keep_plan(job.id, plan_json(rows))
        except StorageUnavailable:
            log.exception("the grown plan is not kept; the Run holds it")

    return Growth(live, commanded, shop.cell.extend, shop.cell.conclude, told)


def analyse(job: Job, run_ids: Sequence[str], control: Control, shop: Workshop) -> None:
    """Turn Runs into error tables."""
    how = job.perpendicular_only, job.monte_carlo, shop.workers
    _conclude(job, run_ids, control, shop, Stage.ALIGNING, shop.science, *how)


def discover(
    job: Job, run_ids: Sequence[str], control: Control, shop: Workshop
) -> None:
    """Find what a model of Runs lacks: one of ours, or the one fitted to them."""
    _conclude(job, run_ids, control, shop, Stage.DISCOVERING, shop.discoverer)


def _conclude(
    job: Job,
    run_ids: Sequence[str],
    control: Control,
    shop: Workshop,
    stage: Stage,
    task: Task,
    *how: object,
) -> None:
    """Let a task make its files of Runs and, where the job names one, of a model."""
    files = [str(shop.runs.file(run_id)) for run_id in run_ids]
    folder, begins = str(shop.results / job.id), (State.RUNNING, stage)
    model = _model(job, shop)
    _computed(control, shop, begins, task, files, folder, *how, *model)


def _model(job: Job, shop: Workshop) -> tuple[str | None, str | None]:
    """Return file and identifier of the model that a job rests on, if it does."""
    model_id = shop.store.plan_request(job.id).get("model_id")
    if model_id is None:
        return None, None
    return str(model_file(shop.results, model_id)), model_id


def _order(job: Job, shop: Workshop) -> Json:
    """Return what is asked of a plan, with the file of the model it rests on."""
    file, _ = _model(job, shop)
    return {**shop.store.plan_request(job.id), "model_file": file}


def _computed(
    control: Control,
    shop: Workshop,
    begins: tuple[State, Stage],
    task: Task,
    *arguments: object,
) -> Any:
    """Return what the executor makes of a task; report, and end when called off.

    begins : state and stage once it is computed
    """

    def report(fraction: float, stage: str) -> None:
        control.report(Progress(fraction, 1.0), stage=_stage(stage))

    def started() -> None:
        control.enter(*begins)

    computation = shop.executor.submit(
        task, *arguments, on_progress=report, started=started
    )
    found = control.compute(computation)
    control.checkpoint()
    return found


def _keep_run(run_id: str, control: Control, shop: Workshop) -> None:
    """Catalogue what was recorded, whole or not."""
    try:
        record = shop.runs.add_measured(run_id)
    except Exception:
        # How the measurement ended is more than what became of its file.
        log.exception("the Run cannot be read; its file is kept")
        return
    if record is not None:
        control.link_run(record.id)


def _stage(name: str) -> Stage | None:
    try:
        return Stage(name)
    except ValueError:
        return None


def _end(control: Control, state: State, failure: Failure | None = None) -> None:
    """Put down the end, as soon as the catalogue takes it."""
    while True:
        try:
            if state is State.ABORTED:
                control.obey(Verb.ABORT)
            job = control.end(state, failure)
        except StorageUnavailable:
            log.exception("the end of the job cannot be put down yet")
            if control.called_off:  # the next start of the service will find it
                return
            time.sleep(TRY_AGAIN_S)
        else:
            log.info("job ended", state=str(job.state), reason=failure)
            return
