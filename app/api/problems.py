"""Every answer that refuses is a problem: the application's handlers, its schema."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.responses import Response

from app.api import failures
from app.api.failures import BY_STATUS, INTERNAL, MEDIA_TYPE, PROBLEM_KINDS, ProblemKind
from app.api.models.problem import Problem

MAX_ERRORS = 20


def declare_problems(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Name the refusals of a route for its documentation; `described` spells them."""
    return {status: {"model": Problem} for status in statuses}


def add_problems(document: dict[str, Any]) -> dict[str, Any]:
    """Return an OpenAPI document in which every refusal is a problem with an example.

    The framework knows neither the media type nor that its own 422 is replaced.
    """
    for path, operations in document["paths"].items():
        for operation in operations.values():
            responses = operation["responses"]
            for status in [s for s in responses if s >= "400"]:
                responses[status] = _describe_refusal(
                    _find_example_kind(int(status)), path
                )
            responses["default"] = _describe_refusal(INTERNAL, path)
    for name in ("HTTPValidationError", "ValidationError"):
        document["components"]["schemas"].pop(name, None)
    return document


def install_handlers(app: FastAPI) -> None:
    """Turn every error of the application's routes into a problem."""
    for family in PROBLEM_KINDS:
        app.add_exception_handler(family, _handle_family)
    app.add_exception_handler(RequestValidationError, _handle_validation)
    app.add_exception_handler(HTTPException, _handle_http)


def make_problem_response(
    content: Mapping[str, Any],
    instance: str,
    request_id: str,
    headers: Mapping[str, str] | None = None,
) -> Response:
    """Return a problem as an answer."""
    body = {**content, "instance": instance, "request_id": request_id}
    text = json.dumps(body, ensure_ascii=False, allow_nan=False)
    return Response(text, content["status"], headers, MEDIA_TYPE)


def find_kind_of_status(status: int) -> ProblemKind:
    """Return the kind of problem that a bare status is."""
    if status in BY_STATUS:
        return BY_STATUS[status]
    if status >= 500:
        return INTERNAL
    known = BY_STATUS[400]
    return ProblemKind(status, known.code, known.title, known.action)


def _handle_family(request: Request, error: Exception) -> Response:
    return _respond(request, failures.describe_error(error))


def _handle_validation(request: Request, error: Exception) -> Response:
    assert isinstance(error, RequestValidationError)  # noqa: S101 (by registration)
    # `input` and `ctx` stay out: they echo what was sent and may not be JSON.
    found = [
        {
            "location": [str(part) for part in item["loc"]],
            "message": str(item["msg"]),
            "type": str(item["type"]),
        }
        for item in error.errors()[:MAX_ERRORS]
    ]
    first = found[0]
    detail = f"{'.'.join(first['location'])}: {first['message']}"
    return _respond(
        request, failures.problem(BY_STATUS[422], detail, {"errors": found})
    )


def _handle_http(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)  # noqa: S101 (by registration)
    kind = find_kind_of_status(error.status_code)
    detail = (
        ""
        if error.detail == _find_default_phrase(error.status_code)
        else str(error.detail)
    )
    return _respond(request, failures.problem(kind, detail), error.headers)


def _find_default_phrase(status: int) -> str:
    return HTTPException(status).detail


def _respond(
    request: Request,
    content: Mapping[str, Any],
    headers: Mapping[str, str] | None = None,
) -> Response:
    request_id = request.scope.get("state", {}).get("request_id", "")
    return make_problem_response(content, request.url.path, request_id, headers)


def _describe_refusal(kind: ProblemKind, path: str) -> dict[str, Any]:
    example = {
        **failures.problem(kind),
        "instance": path,
        "request_id": "6f0e4c1b9a7d4e52",
    }
    schema = {"$ref": "#/components/schemas/Problem"}
    content = {MEDIA_TYPE: {"schema": schema, "example": example}}
    return {"description": kind.title, "content": content}


def _find_example_kind(status: int) -> ProblemKind:
    """Return a kind of problem with that status, as an example."""
    by_family = (kind for kind in PROBLEM_KINDS.values() if kind.status == status)
    plain = BY_STATUS.get(status, INTERNAL)
    return plain if status == 422 else next(by_family, plain)
