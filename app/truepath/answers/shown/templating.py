"""Templates to pages: one environment that escapes every text from outside."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

from jinja2 import (
    Environment,
    FileSystemBytecodeCache,
    FileSystemLoader,
    StrictUndefined,
)
from jinja2.bccache import Bucket
from markupsafe import Markup

from truepath.answers.shown.number_format import format_number

View = dict[str, Any]
"""What a template shows, by name: texts, numbers, and figures as Markup."""


class CompiledTemplates(FileSystemBytecodeCache):
    """Compiled templates, in a folder of the user's own: each is compiled once."""

    def dump_bytecode(self, bucket: Bucket) -> None:
        """Keep a compiled template, if the folder can be written."""
        with suppress(OSError):  # then the next process compiles again
            super().dump_bytecode(bucket)


def find_compiled() -> CompiledTemplates | None:
    """Return the compiled templates, or None where no folder is the user's own."""
    try:
        return CompiledTemplates()
    except (OSError, RuntimeError):
        return None


ENVIRONMENT = Environment(
    loader=FileSystemLoader(Path(__file__).parent / "templates"),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
    bytecode_cache=find_compiled(),
)
ENVIRONMENT.filters["plain"] = format_number  # pyright: ignore[reportUnknownMemberType]


def render_page(template: str, view: View) -> str:
    """Return a whole page from a template of this room."""
    return ENVIRONMENT.get_template(template).render(view)


def render_part(template: str, view: View) -> Markup:
    """Return a part of a page, in which every text from outside is escaped."""
    return Markup(render_page(template, view))  # noqa: S704
