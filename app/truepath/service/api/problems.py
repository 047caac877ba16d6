"""Refusals as problems (RFC 9457): mapping from errors, handlers, schema.

`problems.toml` alone maps families of errors to kinds of problem. An error missing in
the table is a defect of the service: status 500, the cause in the log under the
request's identifier, never in the answer.
"""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib import import_module
from importlib.resources import files
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.responses import Response
from starlette.types import Scope

from truepath import errors as app_errors
from truepath.catalogue import errors as job_errors
from truepath.catalogue.job import Failure
from truepath.machines.conditions import NotInOrder
from truepath.service.api.models.base import Problem, address
from truepath.users import errors as user_errors

MAX_ERRORS = 20
MEDIA_TYPE = "application/problem+json"
RETRY_AFTER_S = 5
TEXT = {"type": "string"}
BINARY = {**TEXT, "format": "binary"}
_PASSING = frozenset({429, 503})


@dataclass(frozen=True, slots=True)
class ProblemKind:
    """One kind of problem. `action` is the remedy where the error names none."""

    status: int
    code: str
    title: str
    action: str


_TABLE = tomllib.loads(
    files("truepath.service.api").joinpath("problems.toml").read_text("utf-8")
)

PROBLEM_KINDS: Mapping[type[Exception], ProblemKind] = {
    getattr(import_module(module), family): ProblemKind(**kind)
    for module, families in _TABLE["families"].items()
    for family, kind in families.items()
}

BY_STATUS: Mapping[int, ProblemKind] = {
    int(status): ProblemKind(int(status), **kind)
    for status, kind in _TABLE["status"].items()
}
"""Kinds of errors that the framework raises."""
INTERNAL = BY_STATUS[500]


def find_kind(error: type[Exception]) -> ProblemKind:
    """Kind of the nearest base class in the table; INTERNAL without one."""
    for family in error.__mro__:
        if family in PROBLEM_KINDS:
            return PROBLEM_KINDS[family]
    return INTERNAL


_BY_NAME = {
    name: find_kind(error)
    for module in _TABLE["families"]
    for name, error in vars(import_module(module)).items()
    if isinstance(error, type) and issubclass(error, Exception)
}


def describe_error(error: Exception) -> dict[str, Any]:
    """Problem of an error, without the members that depend on the request."""
    kind = find_kind(type(error))
    if kind is INTERNAL:
        return problem(kind)
    extra: dict[str, Any] = {}
    if isinstance(error, job_errors.CellBusy):
        extra["current_job"] = address(f"/jobs/{error.job_id}")
    if isinstance(error, job_errors.NotInControl):
        extra["controller"] = error.controller
    if isinstance(error, NotInOrder):
        extra["conditions"] = [one.type for one in error.obstacles]
    if isinstance(error, job_errors.StillNeeded):
        extra["dependents"] = list(error.dependents)
    if isinstance(error, job_errors.StaleVersion):
        extra["current_version"] = error.current
    if isinstance(error, app_errors.BundleError):
        extra |= {"file": error.file, "row": error.row, "column": error.column}
    return problem(kind, str(error), extra)


def describe_failure(failure: Failure) -> dict[str, Any]:
    """Problem that ended a job. It has no status, as it is no answer."""
    kind = _BY_NAME.get(failure.family, INTERNAL)
    detail = failure.detail if kind is not INTERNAL else ""
    code, action = failure.code or kind.code, failure.action or kind.action
    content = problem(replace(kind, code=code, action=action), detail)
    del content["status"]
    return content


def problem(
    kind: ProblemKind, detail: str = "", extra: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Members of a problem."""
    return {
        "type": f"/problems/{kind.code}",
        "title": kind.title,
        "status": kind.status,
        "detail": detail or f"{kind.title}.",
        "code": kind.code,
        "action": kind.action,
        **(extra or {}),
    }


def declare_problems(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Refusals of a route for its documentation; see `document`."""
    return {status: {"model": Problem} for status in statuses}


def declare_file(
    media_type: str, *refusals: int, schema: Mapping[str, str] = BINARY
) -> dict[int | str, dict[str, Any]]:
    """Answer of a route that sends a file, and its refusals."""
    content = {media_type: {"schema": schema}}
    return {200: {"content": content}, **declare_problems(*refusals)}


def install_handlers(app: FastAPI) -> None:
    """Turn every error of the application's routes into a problem."""
    for family in PROBLEM_KINDS:
        app.add_exception_handler(family, _handle_family)
    app.add_exception_handler(RequestValidationError, _handle_validation)
    app.add_exception_handler(HTTPException, _handle_http)


def make_problem_response(
    content: Mapping[str, Any], scope: Scope, headers: Mapping[str, str] | None = None
) -> Response:
    """Problem as the answer to the request of a scope.

    Temporary ones have Retry-After.
    """
    status = content["status"]
    waiting = {"Retry-After": str(RETRY_AFTER_S)} if status in _PASSING else {}
    request_id = scope.get("state", {}).get("request_id", "")
    body = {**content, "instance": scope["path"], "request_id": request_id}
    text = json.dumps(body, ensure_ascii=False, allow_nan=False)
    return Response(text, status, {**waiting, **(headers or {})}, MEDIA_TYPE)


def find_kind_of_status(status: int) -> ProblemKind:
    """Kind of a problem for a status without a body."""
    if status in BY_STATUS:
        return BY_STATUS[status]
    if status >= 500:
        return INTERNAL
    known = BY_STATUS[400]
    return ProblemKind(status, known.code, known.title, known.action)


def make_error_response(error: Exception, scope: Scope) -> Response:
    """Problem of an error as the answer to the request of a scope."""
    headers: dict[str, str] = {}
    if isinstance(error, user_errors.NotLoggedIn):
        headers["WWW-Authenticate"] = "Bearer"
    if isinstance(error, user_errors.TooManyTries):
        headers["Retry-After"] = str(math.ceil(error.retry_after_s))
    return make_problem_response(describe_error(error), scope, headers)


def _handle_family(request: Request, error: Exception) -> Response:
    return make_error_response(error, request.scope)


def _handle_validation(request: Request, error: Exception) -> Response:
    assert isinstance(error, RequestValidationError)  # noqa: S101 (by registration)
    # `input` and `ctx` stay out: they echo what was sent and may not be JSON.
    found = [
        {
            "location": [str(part) for part in item["loc"]],
            "message": _describe_mismatch(item),
            "type": str(item["type"]),
        }
        for item in error.errors()[:MAX_ERRORS]
    ]
    first = found[0]
    detail = f"{'.'.join(first['location'])}: {first['message']}"
    content = problem(BY_STATUS[422], detail, {"errors": found})
    return make_problem_response(content, request.scope)


def _describe_mismatch(item: Mapping[str, Any]) -> str:
    if item["type"] != "string_pattern_mismatch":
        return str(item["msg"])
    pattern, given = item["ctx"]["pattern"], item["input"]
    if not given:
        return "is empty; give at least one character"
    if not re.fullmatch(pattern, "a"):
        return "is none of the names that there are"
    odd = next((one for one in given if not re.fullmatch(pattern, f"a{one}")), None)
    if odd is None and re.fullmatch(pattern, given[0]):
        return "is too long"
    if odd is None:
        return f"cannot begin with {given[0]!r}; put a letter or digit first"
    return f"holds {odd!a} (U+{ord(odd):04X}), which cannot stand in it; leave it out"


def _handle_http(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)  # noqa: S101 (by registration)
    kind = find_kind_of_status(error.status_code)
    is_default = error.detail == HTTPException(error.status_code).detail
    detail = "" if is_default else str(error.detail)
    return make_problem_response(problem(kind, detail), request.scope, error.headers)
