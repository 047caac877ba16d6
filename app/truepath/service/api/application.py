"""The FastAPI application: routes, problems, guard, documentation.

The page at /docs is made of local files: the shop floor has no CDN. The description of
the interface is checked in, so that changes are visible in review; it is written by
`python -m truepath.service.api.application docs/openapi.json`.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Collection
from functools import cache
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import Any

from fastapi import APIRouter, FastAPI
from fastapi.responses import HTMLResponse, Response
from fastapi.routing import APIRoute
from fastapi.staticfiles import StaticFiles
from starlette.routing import BaseRoute

from truepath.service.api import problems
from truepath.service.api.access_control import AccessControl
from truepath.service.api.document import complete_document
from truepath.service.api.guard import ForwardedHeaders, Guard
from truepath.service.api.models.base import PREFIX
from truepath.service.api.routes import (
    certificates,
    comparisons,
    compensations,
    events,
    jobs,
    machine,
    machine_history,
    machines,
    metrics,
    models,
    plans,
    plugins,
    results,
    runs,
    stopping,
    users,
)
from truepath.service.api.service import Service

MAX_BODY_BYTES = 1 << 20
_FORM_BYTES = 1 << 20
SCHEMA_PATH = "/api/v1/openapi.json"
_ASSETS = files("truepath.service.page") / "static" / "vendor" / "swagger-ui"
_SWAGGER = files("truepath.service.api") / "swagger"

docs = APIRouter(include_in_schema=False)


_DESCRIPTION = """
Calibrates machine tools with a laser tracker. Lengths are in mm, angles in degrees,
errors in µm and µrad, times in s and °C; every key names its unit.

Create a job, follow it, arm it when the machine is clear, take the error tables away.
`POST /api/v1/stop` stops all motion and is never refused. It is no emergency stop: that
is the hard-wired circuit of the machine.
"""
_TAGS = [
    {"name": "jobs", "description": "Measuring and analysing."},
    {
        "name": "plans",
        "description": "What to measure, and what that will tell.",
    },
    {"name": "results", "description": "Error tables, report."},
    {"name": "compensation", "description": "Files that a controller corrects by."},
    {
        "name": "certificates",
        "description": "A result on paper: issued, kept, given out.",
    },
    {"name": "models", "description": "Models of the machine, and how they grew."},
    {"name": "runs", "description": "What was recorded, as measurement bundles."},
    {"name": "machines", "description": "The machine and its devices."},
    {"name": "events", "description": "What happens, as it happens."},
    {"name": "users", "description": "Who may do what, and who did what."},
    {"name": "system", "description": "The service itself."},
]


class _Application(FastAPI):
    def openapi(self) -> dict[str, Any]:
        if self.openapi_schema is None:
            self.openapi_schema = complete_document(super().openapi())
        return self.openapi_schema


def create_application(
    service: Service | None = None,
    *,
    trusted_hosts: Collection[str] = (),
    trusted_proxies: Collection[str] = (),
    root_path: str = "",
    pages: APIRouter | None = None,
) -> FastAPI:
    """Application with all middleware; each call makes a new one.

    service : None only to describe the interface
    trusted_proxies : addresses and networks whose forwarded headers are trusted
    root_path : path at which a proxy shows the service; empty at its root
    pages : routes of the operator page
    """
    max_upload_bytes = service.max_upload_bytes if service else 0
    app = _Application(
        title="Truepath",
        version=version("truepath"),
        summary="Machine tool calibration by laser tracker",
        description=_DESCRIPTION,
        openapi_url=SCHEMA_PATH,
        openapi_tags=_TAGS,
        docs_url=None,
        redoc_url=None,
        generate_unique_id_function=_name_operation,
    )
    app.state.service = service
    app.add_middleware(AccessControl, access=service.access if service else None)
    app.add_middleware(Guard, trusted_hosts=trusted_hosts)
    app.state.metrics = metrics.ServiceMetrics(service)
    app.add_middleware(metrics.RequestTimer, metrics=app.state.metrics)
    app.add_middleware(
        ForwardedHeaders, trusted_proxies=trusted_proxies, root_path=root_path
    )
    problems.install_handlers(app)
    app.router.routes.extend(_list_routes(max_upload_bytes))
    app.mount("/docs/assets", StaticFiles(directory=str(_ASSETS)), name="docs-assets")
    if pages is not None:
        app.include_router(pages)
    return app


@cache
def _list_routes(max_upload_bytes: int) -> tuple[BaseRoute, ...]:
    """Once per process, as it takes long; the same for every service."""
    every = APIRouter(generate_unique_id_function=_name_operation)
    every.include_router(_api(), prefix=PREFIX, max_body_size=MAX_BODY_BYTES)
    every.include_router(
        runs.uploads, prefix=PREFIX, max_body_size=max_upload_bytes + _FORM_BYTES
    )
    every.include_router(machine.probes)
    every.include_router(metrics.router)
    every.include_router(docs)
    return tuple(every.routes)


def _name_operation(route: APIRoute) -> str:
    return route.name


def _api() -> APIRouter:
    api = APIRouter()
    for router in (
        jobs.router,
        results.router,
        stopping.router,
        plans.of_jobs,
        certificates.router,
        comparisons.router,
        compensations.router,
        models.router,
        plans.router,
        runs.router,
        machine.machines,
        machine_history.comparison,
        machine_history.router,
        machines.router,
        compensations.simulated_tables,
        plugins.router,
        machine.system,
        users.router,
        events.router,
    ):
        api.include_router(router)
    return api


@docs.get("/docs", response_class=HTMLResponse)
def docs_page() -> HTMLResponse:
    """Swagger UI from local files."""
    return HTMLResponse((_SWAGGER / "docs.html").read_text("utf-8"))


@docs.get("/docs/begin.js")
def docs_script() -> Response:
    """A separate file: the service's policy forbids scripts inside a page."""
    script = (_SWAGGER / "begin.js").read_text("utf-8")
    return Response(script, media_type="text/javascript")


def describe_interface() -> str:
    """OpenAPI document in the format of the checked-in file."""
    document = create_application().openapi()
    return json.dumps(document, indent=1, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(describe_interface(), encoding="utf-8")
