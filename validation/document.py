"""Writes the numbers of `docs/validation.md`: no figure in it is typed by hand."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

DOCUMENT = Path(__file__).resolve().parent.parent / "docs" / "validation.md"


def write_section(name: str, text: str) -> None:
    """Put text between the markers `<!-- name -->` and `<!-- /name -->`.

    Raises KeyError where the document has no such place.
    """
    content = DOCUMENT.read_text(encoding="utf-8")
    place = re.compile(rf"(<!-- {name} -->\n).*?(<!-- /{name} -->)", re.DOTALL)
    if not place.search(content):
        raise KeyError(f"{DOCUMENT.name} has no section {name!r}")
    written = place.sub(lambda m: f"{m[1]}\n{text.strip()}\n\n{m[2]}", content)
    DOCUMENT.write_text(written, encoding="utf-8")
    print(f"\n{text.strip()}\n", flush=True)


def table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Return a Markdown table; the first column to the left, numbers to the right."""
    lines = [
        "| " + " | ".join(head) + " |",
        "| --- |" + " ---: |" * (len(head) - 1),
    ]
    lines += ["| " + " | ".join(str(cell) for cell in row) + " |" for row in rows]
    return "\n".join(lines)
