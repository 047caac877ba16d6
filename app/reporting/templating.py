"""Templates to pages: one environment that escapes every text from outside."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from app.results.numbers_as_text import expanded, plain

View = dict[str, Any]
"""What a template shows, by name: texts, numbers, and figures as Markup."""


def make_environment(folder: Path) -> Environment:
    """Return the environment of the templates in a folder."""
    return Environment(
        loader=FileSystemLoader(folder),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


ENVIRONMENT = make_environment(Path(__file__).parent / "templates")
ENVIRONMENT.filters.update(plain=plain, expanded=expanded)


def render(template: str, view: View) -> Markup:
    """Return a template of this room with its values in place."""
    return Markup(ENVIRONMENT.get_template(template).render(view))  # noqa: S704
