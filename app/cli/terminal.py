"""Progress on standard error, tables on standard output, for a person at a terminal."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
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

NotedProgress = Callable[..., None]
"""Receives the share done, 0 to 1, the stage, and what else to show (`note`)."""


@contextmanager
def show_progress(title: str) -> Iterator[NotedProgress]:
    """Show a bar while the block runs; a line a stage where no person is watching.

    Yields the callback of the work.
    """
    console = Console(stderr=True)
    if not console.is_terminal:
        yield _make_stage_printer(title)
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

        def on_progress(share: float, stage: str, note: str = "") -> None:
            bars.update(bar, completed=share, description=stage or title, note=note)

        yield on_progress


def _make_stage_printer(title: str) -> NotedProgress:
    last = ""

    def on_progress(share: float, stage: str, note: str = "") -> None:
        nonlocal last
        if stage and stage != last:
            say(f"{title}: {stage}")
            last = stage

    return on_progress


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


def list_files(folder: Path) -> list[Path]:
    """Return the files of a folder, sorted."""
    return sorted(path for path in folder.iterdir() if path.is_file())


def print_files(files: Iterable[Path]) -> None:
    """Write the places of files to standard output, a line each."""
    for file in files:
        print(file)
