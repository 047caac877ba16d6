"""Pages from templates, and numbers as people read them."""

from __future__ import annotations

import math
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

SIGN = {
    "um": "µm",
    "hz": "Hz",
    "urad": "µrad",
    "um_per_s": "µm/s",
    "um_per_m_K": "µm/m/K",
    "um_per_m": "µm/m",
}
"""Units of files as people write them, where they are not the same."""
View = dict[str, Any]
"""What a template shows, by name: texts, numbers, and figures as Markup."""


def format_expanded(value: float, standard: float) -> str:
    """`value ± U`, k = 2, with U at two significant digits, three decimals at most."""
    half = 2.0 * standard
    decimals = 1
    if half > 0.0:
        decimals = min(max(1 - math.floor(math.log10(half)), 0), 3)
    return f"{format_number(value, decimals)} ± {format_number(half, decimals)}"


def format_number(value: float, decimals: int = 1) -> str:
    """With a true minus sign, no negative zero."""
    return f"{value:z.{decimals}f}".replace("-", "−")


class CompiledTemplates(FileSystemBytecodeCache):
    """Cache in a folder of the user's own, so that each template is compiled once."""

    def dump_bytecode(self, bucket: Bucket) -> None:
        """Store a compiled template, if the folder can be written."""
        with suppress(OSError):  # then the next process compiles again
            super().dump_bytecode(bucket)


def open_template_cache() -> CompiledTemplates | None:
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
    bytecode_cache=open_template_cache(),
)
ENVIRONMENT.filters["plain"] = format_number  # pyright: ignore[reportUnknownMemberType]


def render_page(template: str, view: View) -> str:
    """A whole page; `template` is a path below `templates`."""
    return ENVIRONMENT.get_template(template).render(view)


def render_part(template: str, view: View) -> Markup:
    """Markup whose texts from outside are escaped."""
    return Markup(render_page(template, view))  # noqa: S704
