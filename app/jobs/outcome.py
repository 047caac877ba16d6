"""What an error that ended a job means: its final state, and what is told of it."""

from __future__ import annotations

import structlog

from app.errors import TruepathError
from app.jobs.errors import (
    Aborted,
    Interrupted,
    MachineFault,
    MeasurementEnded,
    TaskFailed,
)
from app.jobs.job import Failure
from app.jobs.transitions import State
from drivers.interfaces.errors import DeviceError

log = structlog.get_logger(__name__)


def classify_error(error: Exception) -> tuple[State, Failure | None]:
    """Return the final state that an error means, and what to tell about it."""
    match error:
        case Aborted():
            return State.ABORTED, None
        case Interrupted():
            return State.INTERRUPTED, Failure("Interrupted", str(error))
        case MeasurementEnded():
            state = State.FAULTED if isinstance(error, MachineFault) else State.FAILED
            family = type(error).__name__
            return state, Failure(family, str(error), error.code, error.action)
        case TaskFailed():
            log.warning("task failed", trace=error.trace)
            return State.FAILED, Failure(error.family, error.text)
        case TruepathError() | DeviceError():
            return State.FAILED, Failure(type(error).__name__, str(error))
        case _:
            log.error("job failed unexpectedly", exc_info=error)
            return State.FAILED, Failure(type(error).__name__, str(error))
