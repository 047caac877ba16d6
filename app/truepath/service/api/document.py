"""Additions to the OpenAPI document that the framework writes.

Every refusal and header is declared once and referred to. `examples.json` holds
shortened answers of the service to its simulated devices; jobs are made from their
record, so that they follow it.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from importlib.resources import files
from typing import Any

from truepath.catalogue.job import Job, JobKind, Progress, Stage
from truepath.catalogue.transitions import State
from truepath.machines.cell_status import NOT_READ
from truepath.service.api.job import describe_job
from truepath.service.api.models.base import JOB_ID, OTHER_ID, PREFIX
from truepath.service.api.problems import BY_STATUS, MEDIA_TYPE, PROBLEM_KINDS, problem
from truepath.service.api.route_roles import (
    ANYBODY,
    FREE_TO_STOP,
    LEAST_ROLES,
    NEVER_LIMITED,
    describe_roles,
)
from truepath.users.roles import Role

_OPEN = "More may be added: a reader keeps to what it knows."
_JSON = "application/json"
_READS = frozenset({"get", "head"})
_INSTANCE = {"instance": f"{PREFIX}/jobs", "request_id": "6f0e4c1b9a7d4e52"}

_STRING = {"type": "string"}
_HEADERS: dict[str, tuple[str, dict[str, Any], str | int]] = {
    "X-Request-ID": (
        "Identifier of the request, as in the log of the service; the client's own "
        "where it has sent one.",
        _STRING,
        "6f0e4c1b9a7d4e52",
    ),
    "ETag": (
        "Version of the job, to be sent as If-Match.",
        {**_STRING, "pattern": r'^"\d+"$'},
        '"3"',
    ),
    "Location": (
        "Where the new resource is.",
        {**_STRING, "format": "uri-reference"},
        f"{PREFIX}/jobs/{JOB_ID}",
    ),
    "Link": (
        "The next page, if there is one (RFC 8288).",
        _STRING,
        f'<{PREFIX}/jobs?after=czoxMg%3D%3D>; rel="next"',
    ),
    "Content-Disposition": (
        "Name of the file (RFC 6266).",
        _STRING,
        'attachment; filename="model.json"',
    ),
    "Retry-After": (
        "Seconds to wait before the next try.",
        {"type": "integer", "minimum": 0},
        5,
    ),
    "WWW-Authenticate": ("How to log in.", _STRING, "Bearer"),
}
_OF_SCHEMA = {
    "JobOut": ("ETag",),
    "PlanResource": ("ETag",),
    "JobPage": ("Link",),
    "RunPage": ("Link",),
    "ModelPage": ("Link",),
}
_OF_OPERATION = {
    **dict.fromkeys(
        ("create_job", "create_plan", "create_compensation", "upload_bundle"),
        ("Location",),
    ),
    **dict.fromkeys(
        (
            "get_model",
            "download_machine_temperature",
            "download_error_tables",
            "download_bundle",
            "download_known_lengths",
            "download_compensation",
            "download_compensation_file",
            "download_nc_program",
            "download_plan_nc_program",
        ),
        ("Content-Disposition",),
    ),
}
_OF_STATUS = {401: ("WWW-Authenticate",), 429: ("Retry-After",), 503: ("Retry-After",)}

_STANDING = {
    "machine": "bench-2",
    "stopped": "true",
    "says": "it has stopped (aborted)",
}
_ENDING = {"machine": "default", "stopped": "unknown", "says": NOT_READ}
_TEXTS = {
    "download_error_tables": "error,position_mm,value,uncertainty,unit,extrapolated,"
    "verdict\nEXX,0.0000,0.00000,0.00000,um,0,usable\n",
    "get_report": "<!doctype html><title>Calibration</title>…",
    "get_discovery_report": "<!doctype html><title>Discovery</title>…",
    "get_verification_report": "<!doctype html><title>Verification</title>…",
    "get_certificate_page": "<!doctype html><title>Certificate</title>…",
    "get_certificate_pdf": "%PDF-1.7…",
    "get_comparison_report": "<!doctype html><title>Comparison</title>…",
    "get_trend_report": "<!doctype html><title>Machine over time</title>…",
    "download_nc_program": "0 BEGIN PGM TRUEPATH MM\n…\n9 END PGM TRUEPATH MM\n",
    "download_plan_nc_program": "0 BEGIN PGM TRUEPATH MM\n…\n9 END PGM TRUEPATH MM\n",
    "download_compensation_file": "0.0 0.0000 0.0000\n10.0 0.0012 0.0015\n",
    "download_bundle": "PK…",
    "download_known_lengths": "x1_mm,y1_mm,z1_mm,x2_mm,y2_mm,z2_mm,length_mm,u_mm\n"
    "1000,0,0,3000.02,0,0,2000.01,0.001\n",
    "download_compensation": "PK…",
}
_FORMS = {
    "upload_bundle": {"bundle": "PK…"},
    "create_comparison": {
        "reference": "error,position_mm,direction,value,unit\nEXX,100,+,1.5,um\n"
    },
    "put_known_lengths": {
        "known_lengths": _TEXTS["download_known_lengths"],
    },
}


def complete_document(document: dict[str, Any]) -> dict[str, Any]:
    """Add roles, refusals, headers, examples and open lists to the document."""
    describe_roles(document)
    answers, refused = _read_answers(), set[int]()
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            _complete(operation, answers)
            responses = operation["responses"]
            # The framework knows neither their media type nor that its own 422 is
            # replaced.
            statuses = {int(status) for status in responses if status >= "400"}
            statuses |= set(_list_general_refusals(path, method, operation))
            for status in sorted(statuses):
                responses[str(status)] = _refer("responses", _name(status))
            refused |= statuses
    components = document["components"]
    components["responses"] = {_name(s): _describe_refusal(s) for s in sorted(refused)}
    components["headers"] = {
        name: {
            "description": description,
            "schema": schema,
            "example": example,
            "required": name != "Link",
        }
        for name, (description, schema, example) in _HEADERS.items()
    }
    for name in ("HTTPValidationError", "ValidationError"):
        components["schemas"].pop(name, None)
    _open_lists(document)
    return document


def _complete(operation: dict[str, Any], answers: dict[str, Any]) -> None:
    name = operation["operationId"]
    for parameter in operation.get("parameters", ()):
        if parameter["name"] == "if-match":  # its absence is answered by 428
            parameter["required"] = True
    for response in operation["responses"].values():
        content = response.get("content", {})
        for media_type, shown in content.items():
            examples = answers if media_type == _JSON else _TEXTS
            if name in examples:
                shown["example"] = examples[name]
        reference = content.get(_JSON, {}).get("schema", {}).get("$ref", "")
        own = _OF_SCHEMA.get(reference.rpartition("/")[2], ())
        response["headers"] = _refer_headers(*own, *_OF_OPERATION.get(name, ()))
    body = operation.get("requestBody", {}).get("content", {})
    if "multipart/form-data" in body:
        body["multipart/form-data"]["example"] = _FORMS[name]


def _list_general_refusals(
    path: str, method: str, operation: dict[str, Any]
) -> Iterator[int]:
    # Before the routes answer: log-in, limits, storage.
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


def _describe_refusal(status: int) -> dict[str, Any]:
    kinds = {k.code: k for k in PROBLEM_KINDS.values() if k.status == status}
    if status in BY_STATUS:
        kinds.setdefault(BY_STATUS[status].code, BY_STATUS[status])
    ordered = [kinds[code] for code in sorted(kinds)]
    examples = {
        kind.code: {"summary": kind.title, "value": {**problem(kind), **_INSTANCE}}
        for kind in ordered
    }
    content = {"schema": _refer("schemas", "Problem"), "examples": examples}
    return {
        "description": f"{'; '.join(kind.title for kind in ordered)}.",
        "content": {MEDIA_TYPE: content},
        "headers": _refer_headers(*_OF_STATUS.get(status, ())),
    }


def _refer(part: str, name: str) -> dict[str, str]:
    return {"$ref": f"#/components/{part}/{name}"}


def _refer_headers(*names: str) -> dict[str, Any]:
    return {name: _refer("headers", name) for name in ("X-Request-ID", *names)}


def _read_answers() -> dict[str, Any]:
    text = files("truepath.service.api").joinpath("examples.json").read_text("utf-8")
    kept = json.loads(text)
    ready, running = _make_job(State.READY), _make_job(State.RUNNING)
    pausing, resuming = _make_job(State.PAUSING), _make_job(State.RESUMING)
    aborting = _make_job(State.ABORTING)
    return {
        **kept,
        "get_reanalysed_run": kept["get_result"],
        "set_machine_file": kept["set_machine_devices"],
        "create_job": _make_job(State.QUEUED),
        "list_jobs": {"items": [ready], "next": "czoxMg=="},
        "get_job": ready,
        "rename_job": _make_job(State.READY, name="As found"),
        "arm_job": running,
        "pause_job": pausing,
        "resume_job": resuming,
        "cancel_job": _make_job(State.CANCELLING),
        "acknowledge_job": _make_job(State.PREPARING),
        "abort_job": aborting,
        "take_control": ready,
        "stop_motion": {"jobs": [aborting], "machines": [_STANDING, _ENDING]},
        "stop_machine": {"jobs": [aborting], "machines": [_ENDING]},
        "check_stop": {"jobs": [], "machines": [_STANDING, _ENDING]},
        "check_stop_of_machine": {"jobs": [], "machines": [_STANDING]},
    }


def _make_job(state: State, name: str = "") -> dict[str, Any]:
    moves = state not in (State.QUEUED, State.PREPARING, State.READY)
    job = Job(
        JobKind.MEASURE_OTF,
        id=JOB_ID,
        state=state,
        desired_state=str(State.READY),
        version=3,
        stage=Stage.MEASURING if moves else Stage.WAITING,
        created="2026-05-04T09:30:00.000Z",
        started="2026-05-04T09:31:00.000Z" if moves else None,
        run_id=OTHER_ID if moves else None,
        progress=Progress(4, 22, "lines", 62.5, 14.0, (100.0, 50.0, 20.0)),
        owner="anna",
        name=name,
    )
    return describe_job(job).model_dump(mode="json", by_alias=True)


def _open_lists(document: dict[str, Any]) -> None:
    schemas = document["components"]["schemas"]
    answered = {
        name
        for operations in document["paths"].values()
        for operation in operations.values()
        for response in operation["responses"].values()
        for name in _list_references(response)
    }
    waiting = list(answered)
    while waiting:
        for name in _list_references(schemas[waiting.pop()]):
            if name not in answered:
                answered.add(name)
                waiting.append(name)
    for name in sorted(answered):
        for listed in _find_lists(schemas[name]):
            said = f"{listed.get('description', '')} {_OPEN}"
            listed["description"] = said.strip()


def _list_references(part: Any) -> Iterator[str]:
    for each in _walk(part):
        name = each.get("$ref", "")
        if isinstance(name, str) and name.startswith("#/components/schemas/"):
            yield name.rpartition("/")[2]


def _find_lists(schema: Any) -> Iterator[dict[str, Any]]:
    for each in _walk(schema):
        if isinstance(each.get("enum"), list):
            yield each


def _walk(part: Any) -> Iterator[dict[str, Any]]:
    if isinstance(part, dict):
        yield part
        part = part.values()
    elif not isinstance(part, list):
        return
    for each in part:
        yield from _walk(each)
