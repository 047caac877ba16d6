"""Interactive documentation at /docs from local files: the shop floor has no CDN."""

from __future__ import annotations

from importlib.resources import files

from fastapi import APIRouter, FastAPI
from fastapi.responses import HTMLResponse, Response
from fastapi.staticfiles import StaticFiles

SCHEMA_PATH = "/api/v1/openapi.json"
_ASSETS = "/docs/assets"
_SWAGGER = files("app.api") / "swagger"

router = APIRouter(include_in_schema=False)


@router.get("/docs", response_class=HTMLResponse)
def docs_page() -> HTMLResponse:
    """Return the page."""
    return HTMLResponse((_SWAGGER / "docs.html").read_text("utf-8"))


@router.get("/docs/begin.js")
def docs_script() -> Response:
    """Return its script: the policy of the service forbids scripts inside a page."""
    script = (_SWAGGER / "begin.js").read_text("utf-8")
    return Response(script, media_type="text/javascript")


def mount_assets(app: FastAPI) -> None:
    """Serve the vendored files of swagger-ui."""
    folder = files("app.web") / "static" / "vendor" / "swagger-ui"
    app.mount(_ASSETS, StaticFiles(directory=str(folder)), name="docs-assets")
