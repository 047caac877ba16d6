"""The certificate as one HTML file that needs no other, and as PDF by WeasyPrint.

The same HTML makes the same bytes: no clock and no chance is in it, and nothing is
fetched. See docs/decisions/pdf.md.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import NoReturn, Protocol, cast

from truepath.answers.certificate import (
    closing_sections,
    measurement_sections,
    result_sections,
)
from truepath.answers.certificate.issue import Certificate
from truepath.answers.certificate.language import load_language
from truepath.answers.shown.page import render_page
from truepath.errors import BadInput

REMEDY = (
    "install it with `pip install 'truepath[pdf]'` and the system library Pango "
    "(Debian: libpango-1.0-0 libpangoft2-1.0-0 libharfbuzz-subset0); HTML needs neither"
)
_MISSING = re.compile(r"unsupported by fonts: \"(?P<letter>.+)\" \(U\+\w+\)", re.DOTALL)
_VIEWS = measurement_sections.VIEWS | result_sections.VIEWS | closing_sections.VIEWS


class _Page(Protocol):
    def __init__(
        self, *, string: str, url_fetcher: Callable[..., NoReturn]
    ) -> None: ...

    def write_pdf(self, *, pdf_variant: str) -> bytes | None: ...


class PdfUnavailable(BadInput):
    """No PDF can be made by this installation."""


def require_printer() -> None:
    """Raise PdfUnavailable, with the remedy, where no PDF can be made."""
    _load_printer()


def print_pdf(html: str) -> bytes:
    """PDF/UA-1 of an HTML page.

    Raises PdfUnavailable with the remedy, also where no font has a letter of it: a box
    in its place would make a name unreadable.
    """
    page = _load_printer()(string=html, url_fetcher=_reject)
    with _collect_missing_letters() as missing:
        printed = page.write_pdf(pdf_variant="pdf/ua-1")
    if missing:
        raise PdfUnavailable(
            f"no PDF can be made here: no installed font has {' '.join(missing)}; "
            "install a font that has (Debian: fonts-noto-cjk for Chinese, Japanese and "
            "Korean, fonts-noto-core for most others), or make HTML"
        )
    assert printed is not None  # noqa: S101 (no file was named to write to)
    return printed


@contextmanager
def _collect_missing_letters() -> Generator[dict[str, None]]:
    missing: dict[str, None] = {}

    def keep(record: logging.LogRecord) -> bool:
        found = _MISSING.search(record.getMessage())
        if found:
            missing[found["letter"]] = None
        return False  # it warns of every property of a picture

    log = logging.getLogger("weasyprint")
    log.setLevel(logging.WARNING)  # a service may log errors only
    log.addFilter(keep)
    try:
        yield missing
    finally:
        log.removeFilter(keep)


def _load_printer() -> type[_Page]:
    try:
        # Imported on use: it is an extra, and takes half a second to load.
        from weasyprint import HTML  # pyright: ignore[reportMissingTypeStubs]
    except (ImportError, OSError) as error:
        why = "WeasyPrint is not installed"
        if isinstance(error, OSError):
            why = "WeasyPrint does not find Pango"
        text = f"no PDF can be made here ({why}): {REMEDY}"
        raise PdfUnavailable(text) from error
    return cast(type[_Page], HTML)


def _reject(url: str, *_: object, **__: object) -> NoReturn:
    raise ValueError(f"a certificate fetches nothing, not {url}")


def render_certificate(
    certificate: Certificate, *, accept_verdict: bool = False
) -> str:
    """One file of HTML.

    accept_verdict : also of a result that is not to be used; the page says so

    Raises NotUsable.
    """
    if not accept_verdict:
        verdict = certificate.found.result.verdict
        verdict.require_usable(f"{certificate.found.name}: the result")
        if (left := certificate.left_verdict) and certificate.left:
            left.require_usable(f"{certificate.left.name}: the result as left")
    language = load_language(certificate.language)
    views = {name: view(certificate, language) for name, view in _VIEWS.items()}
    return render_page(
        "certificate.html",
        {
            **views,
            "language": language.code,
            "say": language.text,
            "date": certificate.issued,
        },
    )
