"""How a job ends: what an error means for it, and its end stored."""

from __future__ import annotations

import time

import structlog

from truepath.app.errors import TruepathError
from truepath.app.jobs.active_job import ActiveJob
from truepath.app.jobs.errors import (
    Aborted,
    Cancelled,
    Interrupted,
    LineUnfinished,
    MachineFault,
    MeasurementEnded,
    StorageUnavailable,
    TaskFailed,
)
from truepath.app.jobs.job import Failure, Job
from truepath.app.jobs.transitions import State
from truepath.drivers.interfaces.errors import DeviceError

TRY_AGAIN_S = 0.5
TRY_AGAIN = (
    "Clear the cause, then acknowledge the job again; nothing has moved, and what was "
    "recorded is kept."
)

log = structlog.get_logger(__name__)


def find_cause(error: Exception, active: ActiveJob) -> Exception:
    """Return why the job ended: what a cancelled job trips over is its cancelling."""
    if isinstance(error, TruepathError | DeviceError):
        return error
    try:
        active.checkpoint()
    except (Aborted, Cancelled, Interrupted) as cancelled:
        log.warning("job cancelled", reason=repr(error))
        return cancelled
    return error


def classify_error(error: Exception) -> tuple[State, Failure | None]:
    """Return the final state that an error means, and the failure to show."""
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


def can_be_tried_again(job: Job, active: ActiveJob, state: State) -> bool:
    """Whether a measurement failed before what is left of it could be armed."""
    goes_on = job.kind.measures and job.started is not None
    unarmed = active.state in (State.PREPARING, State.READY)
    return state is State.FAILED and goes_on and unarmed


def store_end(active: ActiveJob, state: State, failure: Failure | None) -> None:
    """Store the end as soon as the catalogue accepts it."""
    while True:
        try:
            job = active.end(state, failure)
        except StorageUnavailable:
            if active.is_interrupted:
                active.forget_end()
                return
            time.sleep(TRY_AGAIN_S)
        else:
            log.info("job ended", state=str(job.state), reason=failure)
            return
