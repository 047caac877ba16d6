"""How a job ends: one record for each kind of end, and which error means which."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

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


@dataclass(frozen=True, slots=True)
class JobSucceeded:
    """The job has done what was asked."""

    state: ClassVar[State] = State.SUCCEEDED
    failure: ClassVar[None] = None


@dataclass(frozen=True, slots=True)
class JobAborted:
    """Somebody ended the job. Not a failure."""

    state: ClassVar[State] = State.ABORTED
    failure: ClassVar[None] = None


@dataclass(frozen=True, slots=True)
class JobInterrupted:
    """The service ended first."""

    failure: Failure
    state: ClassVar[State] = State.INTERRUPTED


@dataclass(frozen=True, slots=True)
class JobFailed:
    """It could not be done; the machine is in order."""

    failure: Failure
    state: ClassVar[State] = State.FAILED


@dataclass(frozen=True, slots=True)
class JobFaulted:
    """Machine, tracker or link failed: somebody has to look."""

    failure: Failure
    state: ClassVar[State] = State.FAULTED


Outcome = JobSucceeded | JobAborted | JobInterrupted | JobFailed | JobFaulted


def describe_interruption(text: str) -> JobInterrupted:
    """Return the end of a job that the end of the service has interrupted."""
    return JobInterrupted(Failure(Interrupted.__name__, text))


def classify_error(error: Exception) -> Outcome:
    """Return the end of a job that an error means."""
    match error:
        case Aborted():
            return JobAborted()
        case Interrupted():
            return describe_interruption(str(error))
        case MeasurementEnded():
            kind = JobFaulted if isinstance(error, MachineFault) else JobFailed
            family = type(error).__name__
            return kind(Failure(family, str(error), error.code, error.action))
        case TaskFailed():
            log.warning("task failed", trace=error.trace)
            return JobFailed(Failure(error.family, error.text))
        case _:
            if not isinstance(error, TruepathError | DeviceError):
                log.error("job failed unexpectedly", exc_info=error)
            return JobFailed(Failure(type(error).__name__, str(error)))
