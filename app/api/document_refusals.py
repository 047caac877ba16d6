"""Refusals in the OpenAPI document: which statuses an operation may answer, and how.

Every status is declared once, with an example of each code that it may carry.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from truepath.app.api.models.base import PREFIX
from truepath.app.api.problems import (
    BY_STATUS,
    MEDIA_TYPE,
    PROBLEM_KINDS,
    ProblemKind,
    problem,
)
from truepath.app.api.route_roles import (
    ANYBODY,
    FREE_TO_STOP,
    LEAST_ROLES,
    NEVER_LIMITED,
)
from truepath.app.users.roles import Role

_READS = frozenset({"get", "head"})
_EXAMPLE = {"instance": f"{PREFIX}/jobs", "request_id": "6f0e4c1b9a7d4e52"}


def add_refusals(document: dict[str, Any]) -> None:
    """Declare every refusal of every operation as a problem with examples.

    The framework knows neither the media type nor that its own 422 is replaced.
    """
    used: set[int] = set()
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            responses = operation["responses"]
            statuses = {int(s) for s in responses if s >= "400"}
            statuses |= set(_list_general(path, method, operation))
            for status in sorted(statuses):
                name = _name(status)
                responses[str(status)] = {"$ref": f"#/components/responses/{name}"}
            used |= statuses
    components = document["components"]
    components["responses"] = {_name(s): _describe(s) for s in sorted(used)}
    for name in ("HTTPValidationError", "ValidationError"):
        components["schemas"].pop(name, None)


def _list_general(path: str, method: str, operation: dict[str, Any]) -> Iterator[int]:
    """Yield what stands before the routes may answer: log-in, limits, storage."""
    route = f"{method.upper()} {path}"
    least = LEAST_ROLES.get(route, Role.ADMINISTRATOR)
    yield from (400, 421, 500)
    if least is not ANYBODY:
        yield from (401, 403)
    if method not in _READS:
        yield 403
        if least is not ANYBODY and route not in NEVER_LIMITED:
            yield 429
    if "requestBody" in operation:
        yield 413
    if path.startswith(PREFIX) and route not in FREE_TO_STOP:
        yield 503


def _name(status: int) -> str:
    return f"Problem{status}"


def _list_kinds(status: int) -> list[ProblemKind]:
    """Return the kinds of problem of a status, by code."""
    kinds = {k.code: k for k in PROBLEM_KINDS.values() if k.status == status}
    if status in BY_STATUS:
        kinds.setdefault(BY_STATUS[status].code, BY_STATUS[status])
    return [kinds[code] for code in sorted(kinds)]


def _describe(status: int) -> dict[str, Any]:
    kinds = _list_kinds(status)
    examples = {
        kind.code: {"summary": kind.title, "value": {**problem(kind), **_EXAMPLE}}
        for kind in kinds
    }
    content = {
        "schema": {"$ref": "#/components/schemas/Problem"},
        "examples": examples,
    }
    titles = "; ".join(kind.title for kind in kinds)
    return {"description": f"{titles}.", "content": {MEDIA_TYPE: content}}
