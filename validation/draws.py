"""A draw of worlds by seed, kept as lines of JSON: it continues where it stopped."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any


def make_parser(description: str | None, kept: Path) -> argparse.ArgumentParser:
    """Return the options of a draw.

    kept : where the outcomes are unless it is said otherwise
    """
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--share", type=float, default=1.0, help="of the whole draw")
    parser.add_argument(
        "--improve", action="store_true", help="other seeds, and no tables in the docs"
    )
    parser.add_argument("--most", type=int, help="worlds to draw now")
    parser.add_argument("--kept", type=Path, default=kept, help="outcomes so far")
    return parser


def read_rows(file: Path) -> list[dict[str, Any]]:
    """Return the outcomes so far, none where there is no file."""
    if not file.exists():
        return []
    return [json.loads(line) for line in file.read_text("utf-8").splitlines()]


def keep_rows(file: Path, rows: Iterable[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """Add outcomes to the file as they come, and pass them on."""
    file.parent.mkdir(parents=True, exist_ok=True)
    with file.open("a", encoding="utf-8") as kept:
        for row in rows:
            kept.write(json.dumps(row) + "\n")
            kept.flush()
            yield row
