"""All kinds of jobs: a request becomes a job, a job is run to its end."""

from __future__ import annotations

from dataclasses import replace

import structlog

from truepath.catalogue.errors import (
    Aborted,
    Cancelled,
    Interrupted,
    LineUnfinished,
    MachineFault,
    MeasurementEnded,
    StorageUnavailable,
    TaskFailed,
)
from truepath.catalogue.job import Failure, Job, JobKind, Json
from truepath.catalogue.transitions import State
from truepath.errors import BadInput, TruepathError
from truepath.jobs.kinds.computing import Analyse, Discover, Reanalyse, Trend
from truepath.jobs.kinds.follow_up import MeasureExtra, Verify
from truepath.jobs.kinds.job_steps import JobSteps, MachineSteps, RequestedJob
from truepath.jobs.kinds.measuring import (
    MeasureAdaptive,
    MeasureOtf,
    MeasureStandstill,
    Plan,
)
from truepath.jobs.running.active_job import ActiveJob
from truepath.jobs.running.context import JobContext
from truepath_drivers import host_clock
from truepath_drivers.interfaces.errors import DeviceError

log = structlog.get_logger(__name__)

TRY_AGAIN_S = 0.5
TRY_AGAIN = (
    "Clear the cause, then acknowledge the job again; nothing has moved, and what was "
    "recorded is kept."
)


KINDS: dict[JobKind, type[JobSteps]] = {
    steps.kind: steps
    for steps in (
        MeasureOtf,
        MeasureStandstill,
        MeasureAdaptive,
        MeasureExtra,
        Verify,
        Plan,
        Analyse,
        Discover,
        Trend,
        Reanalyse,
    )
}


def prepare_job(request: RequestedJob, context: JobContext) -> tuple[Job, Json]:
    """The job of a request, and its plan as the store keeps it.

    Raises BadInput (NotUsable of a model, UnnamedMachine), NotFound, NoMachine.
    """
    steps = KINDS[request.kind]
    if not issubclass(steps, MachineSteps):
        return steps.prepare(request, context)
    machine_cell = context.machines.choose(_name_machine(request, context))
    job, plan = steps.prepare(request, replace(context, machine_cell=machine_cell))
    order = dict(plan.get("request") or {})
    wanted = request.control_compensation
    if wanted is None and order.get("compensation_id") is not None:
        wanted = "on"  # what is proved is the machine with these files
    if wanted is not None:
        plan = {**plan, "request": {**order, "control_compensation": wanted}}
    return replace(
        job, machine=machine_cell.id, machine_version=machine_cell.version
    ), plan


def _name_machine(request: RequestedJob, context: JobContext) -> str | None:
    machine_id = request.machine
    verified = (request.plan_request or {}).get("result_id")
    builds_on = request.plan_id, request.continues, request.discovery_id, verified
    for job_id in builds_on:
        stated = None if job_id is None else context.store.get(job_id).machine
        if stated is not None and machine_id not in (None, stated):
            raise BadInput(
                f"job {job_id} is of machine {stated}, not of {machine_id}; leave "
                "`machine` out, or name another job"
            )
        machine_id = machine_id or stated
    return machine_id


def run_job(job: Job, active: ActiveJob, context: JobContext) -> None:
    """Run a job to its end and store its final state. Raises nothing."""
    with structlog.contextvars.bound_contextvars(job_id=job.id):
        log.info("job begins", kind=str(job.kind))
        state, failure = State.SUCCEEDED, None
        try:
            if job.machine is not None:
                machine_cell = context.machines.choose(job.machine)
                context = replace(context, machine_cell=machine_cell)
            KINDS[job.kind](job, active, context).run()
        except Exception as error:
            cause = _find_cause(error, active)
            if isinstance(cause, Interrupted) and not job.kind.measures:
                _put_back(active)
                return
            state, failure = _classify_error(cause)
        is_resumed = job.kind.measures and job.started is not None
        is_unarmed = active.state in (State.PREPARING, State.READY)
        if failure and state is State.FAILED and is_resumed and is_unarmed:
            state, failure = State.FAULTED, replace(failure, action=TRY_AGAIN)
        _store_end(active, state, failure)


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
