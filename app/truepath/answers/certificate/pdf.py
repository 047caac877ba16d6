"""The certificate as PDF, printed by WeasyPrint from the same HTML.

The same HTML makes the same bytes: no clock and no chance is in it, and nothing is
fetched. See docs/decisions/pdf.md.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import NoReturn, Protocol, cast

from truepath.errors import BadInput

REMEDY = (
    "install it with `pip install 'truepath[pdf]'` and the system library Pango "
    "(Debian: libpango-1.0-0 libpangoft2-1.0-0 libharfbuzz-subset0); HTML needs neither"
)
_MISSING = re.compile(r"unsupported by fonts: \"(?P<letter>.+)\" \(U\+\w+\)", re.DOTALL)
FONT_REMEDY = (
    "install a font that has (Debian: fonts-noto-cjk for Chinese, Japanese and Korean, "
    "fonts-noto-core for most others), or make HTML"
)


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
            f"{FONT_REMEDY}"
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
        text = f"no PDF can be made here ({_say(error)}): {REMEDY}"
        raise PdfUnavailable(text) from error
    return cast(type[_Page], HTML)


def _say(error: Exception) -> str:
    if isinstance(error, ImportError):
        return "WeasyPrint is not installed"
    return "WeasyPrint does not find Pango"


def _reject(url: str, *_: object, **__: object) -> NoReturn:
    raise ValueError(f"a certificate fetches nothing, not {url}")
