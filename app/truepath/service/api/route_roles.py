"""The least role of every route, in one table; a test compares it with the routes.

`ANYBODY` needs no login. `POST /stop` is among them: a stop must never be refused, also
with an expired session, a forgotten password or a catalogue that does not answer. The
worst that a stranger can do with it is to hold the feed.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from starlette.routing import compile_path

from truepath.service.api.models.base import PREFIX
from truepath.users.roles import Role

ANYBODY = None
_VIEWER, _OPERATOR = Role.VIEWER, Role.OPERATOR
_METROLOGIST, _ADMINISTRATOR = Role.METROLOGIST, Role.ADMINISTRATOR

STOP = f"POST {PREFIX}/stop"
STOP_MACHINE = f"POST {PREFIX}/machines/{{machine_id}}/stop"
ABORT = f"POST {PREFIX}/jobs/{{job_id}}/abort"
STOPS = frozenset({STOP, STOP_MACHINE})
CHECKS = frozenset(f"{stop}:check" for stop in STOPS)
"""Path of a stop without its effect: pages call it periodically."""
OPEN_STOP = f"GET {PREFIX}/stop"
"""A WebSocket whose every message is a stop."""
FREE_TO_STOP = STOPS | CHECKS | {OPEN_STOP}
NEVER_LIMITED = STOPS | {ABORT}
"""Exempt from the rate limit and from waiting for the audit log."""

HOLDS = NEVER_LIMITED | {f"POST {PREFIX}/jobs/{{job_id}}/pause"}
"""Stops a machine: on threads that other requests do not use."""

LONG_LIVED = frozenset({f"GET {PREFIX}/events", f"GET {PREFIX}/jobs/{{job_id}}/events"})
"""Streams: a page of another site could read all events from them."""

MOVES = frozenset(
    {
        f"POST {PREFIX}/jobs/{{job_id}}/arming",
        f"POST {PREFIX}/jobs/{{job_id}}/arm",
        f"POST {PREFIX}/jobs/{{job_id}}/resume",
        f"POST {PREFIX}/jobs/{{job_id}}/take-control",
    }
)
"""Moves the machine, leads to it, or decides who may: requires a person."""

_OF_INTERFACE: Mapping[str, Role | None] = {
    "POST /stop": ANYBODY,
    "POST /machines/{machine_id}/stop": ANYBODY,
    "POST /stop:check": ANYBODY,
    "POST /machines/{machine_id}/stop:check": ANYBODY,
    "GET /stop": ANYBODY,
    "GET /session": ANYBODY,
    "POST /session": ANYBODY,
    "DELETE /session": ANYBODY,
    "GET /openapi.json": ANYBODY,
    "POST /jobs": _OPERATOR,
    "GET /jobs": _VIEWER,
    "GET /jobs/{job_id}": _VIEWER,
    "PATCH /jobs/{job_id}": _OPERATOR,
    "DELETE /jobs/{job_id}": _METROLOGIST,
    "POST /jobs/{job_id}/arming": _OPERATOR,
    "POST /jobs/{job_id}/arm": _OPERATOR,
    "POST /jobs/{job_id}/pause": _OPERATOR,
    "POST /jobs/{job_id}/resume": _OPERATOR,
    "POST /jobs/{job_id}/cancel": _OPERATOR,
    "POST /jobs/{job_id}/acknowledge": _OPERATOR,
    "POST /jobs/{job_id}/take-control": _OPERATOR,
    "POST /jobs/{job_id}/abort": _VIEWER,
    "GET /jobs/{job_id}/plan": _VIEWER,
    "GET /jobs/{job_id}/estimate": _VIEWER,
    "GET /jobs/{job_id}/result": _VIEWER,
    "GET /jobs/{job_id}/result/error-tables.json": _VIEWER,
    "GET /jobs/{job_id}/result/error-tables.csv": _VIEWER,
    "GET /jobs/{job_id}/result/report.html": _VIEWER,
    "GET /jobs/{job_id}/result/volumetric-error": _VIEWER,
    "GET /jobs/{job_id}/result/volumetric-map": _VIEWER,
    "GET /jobs/{job_id}/discovery": _VIEWER,
    "GET /jobs/{job_id}/discovery/report.html": _VIEWER,
    "GET /jobs/{job_id}/trend": _VIEWER,
    "GET /jobs/{job_id}/trend/report.html": _VIEWER,
    "GET /jobs/{job_id}/reanalysis": _VIEWER,
    "GET /jobs/{job_id}/reanalysis/runs/{run_id}": _VIEWER,
    "GET /jobs/{job_id}/verification": _VIEWER,
    "GET /jobs/{job_id}/verification/report.html": _VIEWER,
    "GET /jobs/{job_id}/plan/grade": _VIEWER,
    "GET /jobs/{job_id}/nc-program": _VIEWER,
    "GET /jobs/{job_id}/compensations": _VIEWER,
    "GET /jobs/{job_id}/compensations/{compensation_id}": _VIEWER,
    "GET /jobs/{job_id}/compensations/{compensation_id}/files/{name}": _VIEWER,
    "GET /jobs/{job_id}/compensations/{compensation_id}/archive": _VIEWER,
    "GET /jobs/{job_id}/events": _VIEWER,
    "POST /jobs/{job_id}/compensations": _METROLOGIST,
    "GET /jobs/{job_id}/certificates": _VIEWER,
    "GET /jobs/{job_id}/certificates/{number}.html": _VIEWER,
    "GET /jobs/{job_id}/certificates/{number}.pdf": _VIEWER,
    "GET /jobs/{job_id}/certificates/{number}": _VIEWER,
    "POST /jobs/{job_id}/certificates": _METROLOGIST,
    "POST /jobs/{job_id}/certificates/preview": _METROLOGIST,
    "POST /jobs/{job_id}/comparisons": _METROLOGIST,
    "GET /jobs/{job_id}/comparisons/{comparison_id}": _VIEWER,
    "GET /jobs/{job_id}/comparisons/{comparison_id}/report.html": _VIEWER,
    "GET /nc-dialects": _VIEWER,
    "GET /compensation-formats": _VIEWER,
    "GET /drivers": _VIEWER,
    "GET /effects": _VIEWER,
    "GET /models": _VIEWER,
    "GET /models/{model_id}": _VIEWER,
    "GET /models/{model_id}/versions": _VIEWER,
    "GET /models/{model_id}/difference": _VIEWER,
    "POST /plans": _OPERATOR,
    "POST /plans:validate": _VIEWER,
    "GET /plans/{plan_id}": _VIEWER,
    "GET /plans/{plan_id}/nc-program": _VIEWER,
    "GET /plans/{plan_id}/curve": _VIEWER,
    "GET /runs": _VIEWER,
    "POST /runs": _OPERATOR,
    "GET /runs/{run_id}": _VIEWER,
    "PATCH /runs/{run_id}": _OPERATOR,
    "DELETE /runs/{run_id}": _METROLOGIST,
    "GET /runs/{run_id}/bundle": _VIEWER,
    "GET /runs/{run_id}/known-lengths": _VIEWER,
    "PUT /runs/{run_id}/known-lengths": _OPERATOR,
    "DELETE /runs/{run_id}/known-lengths": _OPERATOR,
    "GET /machines": _VIEWER,
    "POST /machines": _ADMINISTRATOR,
    "GET /machines/{machine_id}": _VIEWER,
    "PATCH /machines/{machine_id}": _METROLOGIST,
    "DELETE /machines/{machine_id}": _ADMINISTRATOR,
    "PUT /machines/{machine_id}/machine-file": _ADMINISTRATOR,
    "PUT /machines/{machine_id}/devices": _ADMINISTRATOR,
    "POST /machines/{machine_id}/devices:try": _OPERATOR,
    "POST /machines/{machine_id}:connect": _OPERATOR,
    "GET /machines/{machine_id}/simulated-tables": _VIEWER,
    "PUT /machines/{machine_id}/simulated-tables": _METROLOGIST,
    "DELETE /machines/{machine_id}/simulated-tables": _METROLOGIST,
    "GET /machines/{machine_id}/conditions": _VIEWER,
    "GET /machines/{machine_id}/live": _VIEWER,
    "GET /machines/{machine_id}/history": _VIEWER,
    "GET /machines/{machine_id}/changes": _VIEWER,
    "GET /machines/{machine_id}/temperature": _VIEWER,
    "GET /machines/{machine_id}/temperature/temperature.json": _VIEWER,
    "GET /machines/{machine_id}/standing": _VIEWER,
    "GET /machines:compare": _VIEWER,
    "GET /machines/current": _VIEWER,
    "POST /machines/current:connect": _OPERATOR,
    "GET /machines/current/conditions": _VIEWER,
    "GET /machines/current/live": _VIEWER,
    "GET /system": _VIEWER,
    "GET /events": _VIEWER,
    "GET /users": _ADMINISTRATOR,
    "POST /users": _ADMINISTRATOR,
    "PATCH /users/{name}": _ADMINISTRATOR,
    "DELETE /users/{name}": _ADMINISTRATOR,
    "GET /keys": _ADMINISTRATOR,
    "POST /keys": _ADMINISTRATOR,
    "DELETE /keys/{name}": _ADMINISTRATOR,
    "GET /audit": _ADMINISTRATOR,
}

_BESIDE: Mapping[str, Role | None] = {
    "GET /": ANYBODY,
    "GET /assets/plotly.min.js": ANYBODY,
    "GET /static/{path:path}": ANYBODY,
    "GET /docs": ANYBODY,
    "GET /docs/begin.js": ANYBODY,
    "GET /docs/assets/{path:path}": ANYBODY,
    "GET /healthz": ANYBODY,
    "GET /readyz": ANYBODY,
    "GET /metrics": _VIEWER,
}
"""The page, its files and the probes reveal nothing of a machine; the metrics do."""

LEAST_ROLES: Mapping[str, Role | None] = {
    **{route.replace(" ", f" {PREFIX}", 1): r for route, r in _OF_INTERFACE.items()},
    **_BESIDE,
}

_SAFE = frozenset({"GET", "HEAD", "OPTIONS"})
# Addresses without a parameter first: `/plans:validate` is no plan of that name.
_MATCHERS = [
    (route.split(" ")[0], compile_path(route.split(" ")[1])[0], route)
    for route in sorted(LEAST_ROLES, key=lambda route: route.count("{"))
]


def find_route(method: str, path: str) -> str:
    """Key of `LEAST_ROLES` for a request; empty for none."""
    wanted = "GET" if method == "HEAD" else method
    found = (r for m, pattern, r in _MATCHERS if m == wanted and pattern.match(path))
    return next(found, "")


def find_least_role(method: str, route: str) -> Role | None:
    """Least role of a route; `ANYBODY` is None.

    An undeclared route needs a login to read, else an administrator.
    """
    if route in LEAST_ROLES:
        return LEAST_ROLES[route]
    return Role.VIEWER if method in _SAFE else Role.ADMINISTRATOR


def describe_roles(document: dict[str, Any]) -> dict[str, Any]:
    """An OpenAPI document in which every operation names its least role."""
    schemes = document["components"].setdefault("securitySchemes", {})
    schemes["bearer"] = {
        "type": "http",
        "scheme": "bearer",
        "description": "Token of a session or an API key, where log-in is required.",
    }
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            least = LEAST_ROLES.get(f"{method.upper()} {path}", Role.ADMINISTRATOR)
            operation["x-least-role"] = least or "anybody"
            operation["security"] = [{"bearer": []}] if least else []
    return document
