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
    """Cache in a folder of the user's own, so that each template is compiled once."""

    def dump_bytecode(self, bucket: Bucket) -> None:
        """Store a compiled template, if the folder can be written."""
        with suppress(OSError):  # then the next process compiles again
            super().dump_bytecode(bucket)


def find_compiled() -> CompiledTemplates | None:
    """None where no folder is the user's own."""
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
    """A whole page; `template` is a path below `templates`."""
    return ENVIRONMENT.get_template(template).render(view)


def render_part(template: str, view: View) -> Markup:
    """Markup whose texts from outside are escaped."""
    return Markup(render_page(template, view))  # noqa: S704
