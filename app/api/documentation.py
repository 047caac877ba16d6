"""Interactive documentation at /docs from files of ours: the shop floor has no CDN."""

from __future__ import annotations

from importlib.resources import files

from fastapi import APIRouter, FastAPI
from fastapi.responses import HTMLResponse, Response
from fastapi.staticfiles import StaticFiles

SCHEMA_PATH = "/api/v1/openapi.json"
_ASSETS = "/docs/assets"

router = APIRouter(include_in_schema=False)

_PAGE = f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>Truepath: REST interface</title>
<link rel="stylesheet" href="{_ASSETS}/swagger-ui.css">
<link rel="icon" href="data:,">
</head>
<body>
<div id="docs"></div>
<script src="{_ASSETS}/swagger-ui-bundle.js"></script>
<script src="/docs/begin.js"></script>
</body>
</html>
"""
_BEGIN = f"""SwaggerUIBundle({{
  url: "{SCHEMA_PATH}",
  dom_id: "#docs",
  deepLinking: true,
  tryItOutEnabled: true,
  validatorUrl: null,
}});
"""


@router.get("/docs", response_class=HTMLResponse)
def docs_page() -> HTMLResponse:
    """Return the page."""
    return HTMLResponse(_PAGE)


@router.get("/docs/begin.js")
def docs_script() -> Response:
    """Return its script: the policy of the service forbids scripts inside a page."""
    return Response(_BEGIN, media_type="text/javascript")


def mount_assets(app: FastAPI) -> None:
    """Serve the vendored files of swagger-ui."""
    folder = files("app.web") / "static" / "vendor" / "swagger-ui"
    app.mount(_ASSETS, StaticFiles(directory=str(folder)), name="docs-assets")
