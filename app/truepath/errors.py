"""Families of errors of the service; each says what is wrong, where, the remedy."""

from __future__ import annotations

from functools import partial
from typing import Any


class TruepathError(Exception):
    """Root of the service's own errors."""


class BadInput(TruepathError):
    """Something a user gave cannot be used: exit status 2, or 4xx over HTTP."""


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
    """The control compensated as it was measured, and nobody says by which tables."""


class NotUsable(BadInput):
    """A result that says of itself that it is not to be used."""


class PlanningError(BadInput):
    """A plan that must not reach the machine."""


class OutOfTravel(PlanningError):
    """A commanded position beyond the travel of an axis."""


class EstimationError(TruepathError):
    """The data do not carry the answer that was asked of them."""


class AlignmentError(EstimationError):
    """The stream and the commanded path do not match."""


class Unidentifiable(EstimationError):
    """Parameters that no data of this kind can tell; named in the text."""


class JobError(TruepathError):
    """A job that cannot do what was asked of it."""


class IllegalTransition(JobError):
    """The job's state does not allow that verb."""


class NotFound(JobError):
    """No such job, run or result."""


class MeasurementFailed(TruepathError):
    """A measurement that ended before its path did; what was recorded is kept."""


class WorkerDied(TruepathError):
    """A computing process ended without an answer: killed, or out of memory."""
