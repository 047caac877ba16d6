"""Families of errors of the service; texts give problem, place and remedy."""

from __future__ import annotations

from functools import partial
from typing import Any


class TruepathError(Exception):
    """Root of the service's own errors."""


class BadInput(TruepathError):
    """Input of a user that cannot be used: exit status 2, or 4xx over HTTP."""


class BundleError(BadInput):
    """A file that cannot be used, with the place in it."""

    def __init__(
        self,
        problem: str,
        *,
        file: str,
        row: int | None = None,
        column: str | None = None,
        remedy: str = "",
    ) -> None:
        self.problem, self.file, self.row = problem, file, row
        self.column, self.remedy = column, remedy
        place = file
        if row is not None:
            place += f", row {row}"
        if column is not None:
            place += f", column {column}"
        super().__init__(f"{place}: {problem}" + (f"; {remedy}" if remedy else ""))

    def __reduce__(self) -> tuple[Any, ...]:
        """Cross to another process whole: `args` alone do not make it again."""
        place = {"file": self.file, "row": self.row, "column": self.column}
        return partial(BundleError, remedy=self.remedy, **place), (self.problem,)


class ActiveTablesUnknown(BadInput):
    """The control compensated during the measurement, by unknown tables."""


class NotUsable(BadInput):
    """A result whose verdict forbids its use."""


class PlanningError(BadInput):
    """A plan that must not reach the machine."""


class OutOfTravel(PlanningError):
    """A commanded position beyond the travel of an axis."""


class EstimationError(TruepathError):
    """The data do not determine the requested answer."""


class AlignmentError(EstimationError):
    """The stream and the commanded path do not match."""


class Unidentifiable(EstimationError):
    """Parameters that no data of this kind determine; named in the text."""


class JobError(TruepathError):
    """A job that cannot satisfy a request."""


class IllegalTransition(JobError):
    """The job's state does not allow that verb."""


class NotFound(JobError):
    """No such job, run or result."""


class MeasurementFailed(TruepathError):
    """A measurement that ended before its path did; recorded data are kept."""


class WorkerDied(TruepathError):
    """A computing process ended without an answer: killed, or out of memory."""
