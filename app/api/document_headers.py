"""Headers in the OpenAPI document: what answers carry, what requests must carry."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

_TEXT = {"type": "string"}
_HEADERS: dict[str, dict[str, Any]] = {
    "X-Request-ID": {
        "description": "Identifier of the request, as in the log of the service; the "
        "client's own where it has sent one.",
        "schema": _TEXT,
        "example": "6f0e4c1b9a7d4e52",
    },
    "ETag": {
        "description": "Version of the job, to be sent as If-Match.",
        "schema": {"type": "string", "pattern": r'^"\d+"$'},
        "example": '"3"',
    },
    "Location": {
        "description": "Where the new resource is.",
        "schema": {"type": "string", "format": "uri-reference"},
        "example": "/api/v1/jobs/019a3f5e-7a11-7c3e-9d64-2b1f0c5e8a90",
    },
    "Link": {
        "description": "The next page, if there is one (RFC 8288).",
        "schema": _TEXT,
        "example": '</api/v1/jobs?after=czoxMg%3D%3D>; rel="next"',
    },
    "Content-Disposition": {
        "description": "Name of the file (RFC 6266).",
        "schema": _TEXT,
        "example": 'attachment; filename="model.json"',
    },
    "Retry-After": {
        "description": "Seconds to wait before the next try.",
        "schema": {"type": "integer", "minimum": 0},
        "example": 5,
    },
    "WWW-Authenticate": {
        "description": "How to log in.",
        "schema": _TEXT,
        "example": "Bearer",
    },
}
_OPTIONAL = frozenset({"Link"})

_VERSIONED = frozenset({"JobOut", "PlanResource"})
_CREATING = frozenset(
    {"create_job", "create_plan", "create_compensation", "upload_bundle"}
)
_LISTING = frozenset({"JobPage", "RunPage", "ModelPage"})
_NAMED = frozenset(
    {
        "get_model",
        "download_machine_temperature",
        "download_error_tables",
        "download_bundle",
        "download_compensation",
        "download_compensation_file",
        "download_nc_program",
        "download_plan_nc_program",
    }
)
_OF_STATUS = {
    "401": ("WWW-Authenticate",),
    "429": ("Retry-After",),
    "503": ("Retry-After",),
}


def add_headers(document: dict[str, Any]) -> None:
    """Declare headers of requests and answers.

    A version is required where the framework takes it for optional, so that its
    absence is answered by 428.
    """
    components = document["components"]
    for operations in document["paths"].values():
        for operation in operations.values():
            for parameter in operation.get("parameters", ()):
                if parameter["name"] == "if-match":
                    parameter["required"] = True
            for response in operation["responses"].values():
                if "$ref" not in response:
                    names = _list_names(operation["operationId"], response)
                    response["headers"] = _refer("X-Request-ID", *names)
    for name, response in components["responses"].items():
        names = _OF_STATUS.get(name.removeprefix("Problem"), ())
        response["headers"] = _refer("X-Request-ID", *names)
    components["headers"] = {
        name: {**header, "required": name not in _OPTIONAL}
        for name, header in _HEADERS.items()
    }


def _list_names(operation_id: str, response: dict[str, Any]) -> Iterator[str]:
    content = response.get("content", {}).get("application/json", {})
    schema = content.get("schema", {}).get("$ref", "").rpartition("/")[2]
    if schema in _VERSIONED:
        yield "ETag"
    if schema in _LISTING:
        yield "Link"
    if operation_id in _CREATING:
        yield "Location"
    if operation_id in _NAMED:
        yield "Content-Disposition"


def _refer(*names: str) -> dict[str, Any]:
    return {name: {"$ref": f"#/components/headers/{name}"} for name in names}
