"""The part of a page that a script writes, between two markers."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path


def write_section(page: Path, begin: str, end: str, write: Callable[[], str]) -> int:
    """Write the part anew; with `--check`, return 1 where it is not up to date."""
    old = page.read_text(encoding="utf-8")
    head, rest = old.split(begin)
    new = f"{head}{begin}\n{write()}\n{end}{rest.split(end)[1]}"
    if "--check" in sys.argv[1:]:
        return int(new != old)
    page.write_text(new, encoding="utf-8")
    return 0
