"""From a family of errors to a problem (RFC 9457): `problems.toml` alone decides.

What is not in the table is a defect of the service: status 500, the cause in the log
under the request's identifier, never in the answer.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from importlib.resources import files
from typing import Any

from app import errors as app_errors
from app.jobs import errors as job_errors
from app.jobs.job import Failure

MEDIA_TYPE = "application/problem+json"


@dataclass(frozen=True, slots=True)
class ProblemKind:
    """One kind of problem. `action` is the way out where the error names none."""

    status: int
    code: str
    title: str
    action: str


INTERNAL = ProblemKind(
    500,
    "internal-error",
    "The service failed",
    "Report the request identifier with the log of the service.",
)

_TABLE = tomllib.loads(files("app.api").joinpath("problems.toml").read_text("utf-8"))

PROBLEM_KINDS: Mapping[type[Exception], ProblemKind] = {
    getattr(import_module(module), family): ProblemKind(**kind)
    for module, families in _TABLE["families"].items()
    for family, kind in families.items()
}
_BY_NAME = {family.__name__: kind for family, kind in PROBLEM_KINDS.items()}

BY_STATUS: Mapping[int, ProblemKind] = {
    int(status): ProblemKind(int(status), **kind)
    for status, kind in _TABLE["status"].items()
}
"""What the framework raises."""


def find_kind(error: Exception) -> ProblemKind:
    """Return the kind of a problem that an error is; the nearest family counts."""
    for family in type(error).__mro__:
        if family in PROBLEM_KINDS:
            return PROBLEM_KINDS[family]
    return INTERNAL


def describe_error(error: Exception) -> dict[str, Any]:
    """Return the problem that an error is, without what only the request knows."""
    kind = find_kind(error)
    if kind is INTERNAL:
        return problem(kind)
    extra: dict[str, Any] = {}
    if isinstance(error, job_errors.CellBusy):
        extra["current_job"] = f"/api/v1/jobs/{error.job_id}"
    if isinstance(error, job_errors.StaleVersion):
        extra["current_version"] = error.current
    if isinstance(error, app_errors.BundleError):
        extra |= {"file": error.file, "row": error.row, "column": error.column}
    return problem(kind, str(error), extra)


def describe_failure(failure: Failure) -> dict[str, Any]:
    """Return the problem that ended a job. It has no status: it is no answer."""
    kind = _BY_NAME.get(failure.family, INTERNAL)
    detail = failure.detail if kind is not INTERNAL else ""
    code = failure.code or kind.code
    content = problem(kind, detail)
    del content["status"]
    return {
        **content,
        "type": f"/problems/{code}",
        "code": code,
        "action": failure.action or kind.action,
    }


def problem(
    kind: ProblemKind, detail: str = "", extra: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Return the members of a problem."""
    return {
        "type": f"/problems/{kind.code}",
        "title": kind.title,
        "status": kind.status,
        "detail": detail or f"{kind.title}.",
        "code": kind.code,
        "action": kind.action,
        **(extra or {}),
    }
