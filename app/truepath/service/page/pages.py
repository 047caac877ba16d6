"""The shell of the operator page, its texts by language, and its files."""

from __future__ import annotations

import json
import os
from dataclasses import asdict
from functools import cache
from hashlib import sha256
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from urllib.parse import urlencode

from fastapi import APIRouter, Request
from fastapi.responses import FileResponse, HTMLResponse, JSONResponse
from fastapi.staticfiles import StaticFiles
from fastapi.templating import Jinja2Templates
from starlette.responses import Response
from starlette.types import Scope

from truepath.catalogue.transitions import FINAL, State
from truepath.kinematics.effects.family import list_families

STATIC_PATH = "/static"
LANGUAGES = ("en", "de")
DEFAULT_LANGUAGE = "en"
LANGUAGE_COOKIE = "truepath_language"

# After a stop the page waits for these jobs; the newest 200, the most of one answer.
# Those that end without a word of the controller are among them.
_UNHEARD = (State.FAULTED, State.INTERRUPTED)
_UNSETTLED = [*_UNHEARD, *(state for state in State if state not in FINAL)]
_UNSETTLED_JOBS = urlencode({"limit": 200, "state": _UNSETTLED}, doseq=True)

_VARY = {"Vary": "Accept-Language, Cookie"}
# The page of an updated service must never run on the modules of the one before: it
# asks for them under another address, and for all else each time.
_REVALIDATE = {"Cache-Control": "no-cache"}
_KEEP = {"Cache-Control": "private, max-age=31536000, immutable"}

_HERE = Path(__file__).parent
_STATIC = _HERE / "static"
_templates = Jinja2Templates(directory=_HERE / "templates")

router = APIRouter(include_in_schema=False)


class PageFiles(StaticFiles):
    """Static files: a browser keeps those that it requests under their digest.

    It revalidates all others each time it needs them. Texts of a language include
    those of effects.
    """

    async def get_response(self, path: str, scope: Scope) -> Response:
        """The file, or 304, with headers that control its reuse."""
        first, _, rest = path.partition(os.sep)
        is_kept = first == digest_files()
        wanted = Path(rest if is_kept else path)
        if str(wanted.parent) == "locales" and wanted.stem in LANGUAGES:
            response: Response = JSONResponse(catalogue(wanted.stem))
        else:
            response = await super().get_response(str(wanted), scope)
        response.headers.update(_KEEP if is_kept else _REVALIDATE)
        return response


def static_files() -> StaticFiles:
    """Application to mount at `STATIC_PATH`."""
    digest_files()  # reads them all, which no answer is to wait for
    return PageFiles(directory=_STATIC)


@cache
def digest_files() -> str:
    """Short digest of all files and texts of the page, read once per process."""
    digest = sha256()
    for file in sorted(_STATIC.rglob("*")):
        if file.is_file():
            digest.update(str(file.relative_to(_STATIC)).encode())
            digest.update(file.read_bytes())
    for language in LANGUAGES:
        digest.update(json.dumps(_effect_texts(language)).encode())
    return digest.hexdigest()[:16]


@router.get("/", response_class=HTMLResponse)
def operator_page(request: Request) -> HTMLResponse:
    """The shell of the page in the operator's language."""
    language = choose_language(
        request.cookies.get(LANGUAGE_COOKIE), request.headers.get("accept-language")
    )
    # Relative to the page, wherever a proxy shows it; absolute where that is known.
    base = getattr(request.state, "base", "")
    at = f"{base}/" if base else ""
    context = {
        "language": language,
        "languages": LANGUAGES,
        "text": catalogue(language),
        "version": version("truepath"),
        "static": f"{at}{STATIC_PATH.lstrip('/')}/{digest_files()}",
        "api": f"{at}api/v1",
        "unsettled_jobs": _UNSETTLED_JOBS,
    }
    return _templates.TemplateResponse(request, "index.html", context, headers=_VARY)


@router.get("/assets/plotly.min.js", response_class=FileResponse)
def plotly_script() -> FileResponse:
    """plotly.js from the wheel of plotly."""
    script = files("plotly") / "package_data" / "plotly.min.js"
    return FileResponse(
        str(script), media_type="text/javascript", headers=dict(_REVALIDATE)
    )


def catalogue(language: str) -> dict[str, str]:
    """Texts of one of `LANGUAGES` by key, those of effects included."""
    if language not in LANGUAGES:
        raise KeyError(language)
    return _read_texts(language) | _effect_texts(language)


@cache
def _read_texts(language: str) -> dict[str, str]:
    path = files("truepath.service.page") / "static" / "locales" / f"{language}.json"
    return json.loads(path.read_text(encoding="utf-8"))


def _effect_texts(language: str) -> dict[str, str]:
    """A discovery includes the English sentences; only others are needed here."""
    texts: dict[str, str] = {}
    for family in list_families():
        if words := family.words.get(language):
            key = f"effect.{family.name}"
            texts[key] = words.title
            if language != DEFAULT_LANGUAGE:
                sentences = {f"{key}.{k}": text for k, text in asdict(words).items()}
                texts |= {k: s for k, s in sentences.items() if k != f"{key}.title"}
    return texts


def choose_language(remembered: str | None, accepted: str | None) -> str:
    """Language that the operator set, else the browser's, else English.

    accepted : an Accept-Language header
    """
    weighed = [_parse_weight(part) for part in (accepted or "").split(",")]
    weighed.sort(key=lambda pair: -pair[0])
    wanted = [remembered or "", *(tag for _, tag in weighed)]
    known = (tag.split("-")[0].lower() for tag in wanted)
    return next((tag for tag in known if tag in LANGUAGES), DEFAULT_LANGUAGE)


def _parse_weight(part: str) -> tuple[float, str]:
    tag, _, parameter = part.strip().partition(";")
    weight = parameter.strip().removeprefix("q=")
    try:
        return float(weight or 1.0), tag.strip()
    except ValueError:
        return 0.0, tag.strip()
