"""Progress on standard error, tables on standard output, for a person at a terminal."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    TaskProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table

# (share done 0..1, what is being done, what else to show)
Report = Callable[..., None]


@contextmanager
def progress(title: str) -> Iterator[Report]:
    """Show a bar while the block runs; a line a stage where no person is watching.

    Yields report(share, stage, note=""), share being 0..1 of the whole.
    """
    console = Console(stderr=True)
    if not console.is_terminal:
        yield _stage_lines(title)
        return
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}"),
    )
    with Progress(*columns, console=console) as bars:
        bar = bars.add_task(title, total=1.0, note="")

        def report(share: float, stage: str, note: str = "") -> None:
            bars.update(bar, completed=share, description=stage or title, note=note)

        yield report


def _stage_lines(title: str) -> Report:
    last = ""

    def report(share: float, stage: str, note: str = "") -> None:
        nonlocal last
        if stage and stage != last:
            say(f"{title}: {stage}")
            last = stage

    return report


def say(text: str) -> None:
    """Write a line to standard error."""
    print(text, file=sys.stderr, flush=True)


def print_json(summary: Mapping[str, Any]) -> None:
    """Write one JSON object to standard output."""
    print(json.dumps(summary, indent=1, allow_nan=False), flush=True)


def print_table(
    title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]
) -> None:
    """Write a table to standard output: names left, numbers right."""
    table = Table(title=title, title_justify="left")
    for number, name in enumerate(columns):
        table.add_column(name, justify="left" if number == 0 else "right")
    for row in rows:
        table.add_row(*row)
    Console().print(table)
