"""Writes the numbers of a page of `docs`: no figure in them is typed by hand."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

DOCUMENT = Path(__file__).resolve().parent.parent / "docs" / "validation.md"


def write_section(name: str, text: str, document: Path | None = None) -> None:
    """Put text between the markers `<!-- name -->` and `<!-- /name -->`.

    document : `docs/validation.md` where it is left out
    Raises KeyError where the document has no such place.
    """
    page = document or DOCUMENT
    content = page.read_text(encoding="utf-8")
    place = re.compile(rf"(<!-- {name} -->\n).*?(<!-- /{name} -->)", re.DOTALL)
    if not place.search(content):
        raise KeyError(f"{page.name} has no section {name!r}")
    written = place.sub(lambda m: f"{m[1]}\n{text.strip()}\n\n{m[2]}", content)
    page.write_text(written, encoding="utf-8")
    print(f"\n{text.strip()}\n", flush=True)


def table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Return a Markdown table; the first column to the left, numbers to the right."""
    lines = [
        "| " + " | ".join(head) + " |",
        "| --- |" + " ---: |" * (len(head) - 1),
    ]
    lines += ["| " + " | ".join(str(cell) for cell in row) + " |" for row in rows]
    return "\n".join(lines)
