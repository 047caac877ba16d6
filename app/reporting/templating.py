"""Templates to pages: one environment that escapes every text from outside."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from app.results.number_format import format_number

View = dict[str, Any]
"""What a template shows, by name: texts, numbers, and figures as Markup."""


def make_environment(folder: Path) -> Environment:
    """Return the environment of the templates in a folder."""
    environment = Environment(
        loader=FileSystemLoader(folder),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["plain"] = format_number  # pyright: ignore[reportUnknownMemberType]
    return environment


ENVIRONMENT = make_environment(Path(__file__).parent / "templates")


def render_page(template: str, view: View) -> str:
    """Return a whole page from a template of this room."""
    return ENVIRONMENT.get_template(template).render(view)


def render_part(template: str, view: View) -> Markup:
    """Return a part of a page, in which every text from outside is escaped."""
    return Markup(render_page(template, view))  # noqa: S704
