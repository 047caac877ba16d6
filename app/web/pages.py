"""The shell of the operator page and the files it loads."""

from __future__ import annotations

from importlib.metadata import version
from importlib.resources import files
from pathlib import Path

from fastapi import APIRouter, Request
from fastapi.responses import FileResponse, HTMLResponse
from fastapi.staticfiles import StaticFiles
from fastapi.templating import Jinja2Templates
from starlette.responses import Response
from starlette.types import Scope

from app.api.security import HEADERS
from app.web.catalogues import LANGUAGES, catalogue, choose_language

STATIC_PATH = "/static"
LANGUAGE_COOKIE = "truepath_language"

_PAGE_HEADERS = {**HEADERS, "Vary": "Accept-Language, Cookie"}
# The page of an updated service must never run on the modules of the one before.
_REVALIDATE = {"Cache-Control": "no-cache", "X-Content-Type-Options": "nosniff"}

_HERE = Path(__file__).parent
_templates = Jinja2Templates(directory=_HERE / "templates")

router = APIRouter(include_in_schema=False)


class PageFiles(StaticFiles):
    """Static files that a browser asks after each time it needs them."""

    async def get_response(self, path: str, scope: Scope) -> Response:
        """Return the file, or 304, with headers that forbid unchecked reuse."""
        response = await super().get_response(path, scope)
        response.headers.update(_REVALIDATE)
        return response


def static_files() -> StaticFiles:
    """Return the application to mount at `STATIC_PATH`."""
    return PageFiles(directory=_HERE / "static")


@router.get("/", response_class=HTMLResponse)
def operator_page(request: Request) -> HTMLResponse:
    """Return the shell of the page in the operator's language."""
    language = choose_language(
        request.cookies.get(LANGUAGE_COOKIE), request.headers.get("accept-language")
    )
    context = {
        "language": language,
        "languages": LANGUAGES,
        "text": catalogue(language),
        "version": version("truepath"),
        "static": STATIC_PATH,
    }
    return _templates.TemplateResponse(
        request, "index.html", context, headers=_PAGE_HEADERS
    )


@router.get("/assets/plotly.min.js", response_class=FileResponse)
def plotly_script() -> FileResponse:
    """Return plotly.js out of the wheel of plotly."""
    script = files("plotly") / "package_data" / "plotly.min.js"
    return FileResponse(
        str(script), media_type="text/javascript", headers=dict(_REVALIDATE)
    )
