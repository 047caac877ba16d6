"""Common to commands: options, progress, tables, the client of a running service."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from truepath.errors import BadInput, JobError

if TYPE_CHECKING:
    from truepath.client import Client

Config = Annotated[
    Path | None, typer.Option("--config", metavar="FILE", help="Settings, as TOML.")
]
DataDir = Annotated[
    Path | None,
    typer.Option("--data-dir", metavar="DIR", help="Runs, results, catalogue."),
]
Json = Annotated[
    bool, typer.Option("--json", help="Print the summary on standard output as JSON.")
]
OutputFile = Annotated[
    Path, typer.Option("--output", "-o", metavar="FILE", help="What to write.")
]
OutputFolder = Annotated[
    Path, typer.Option("--output", "-o", metavar="DIR", help="Where the files go.")
]
PerpendicularOnly = Annotated[
    bool,
    typer.Option(
        "--perpendicular-only", help="Leave out what is seen along each line."
    ),
]
ResultFile = Annotated[
    Path,
    typer.Argument(metavar="RESULT.json", help="What `analyse` or `discover` wrote."),
]

NotedProgress = Callable[..., None]
"""Receives the fraction done, 0 to 1, the stage, and further text (`note`)."""
Address = Annotated[
    str, typer.Option("--address", metavar="URL", help="Of the service.")
]
KeyFile = Annotated[
    Path | None,
    typer.Option(
        "--key-file", metavar="FILE", help="Holds an API key, where it asks for one."
    ),
]
CaFile = Annotated[
    Path | None,
    typer.Option(
        "--ca-file",
        metavar="FILE",
        help="Certificates to trust for https, where they are your own.",
    ),
]
HERE = "http://127.0.0.1:8411"


@contextmanager
def show_progress(title: str) -> Iterator[NotedProgress]:
    """Show a bar while the block runs; one line per stage without a terminal.

    Yields the callback of the work.
    """
    from rich.console import Console

    console = Console(stderr=True)
    if not console.is_terminal:
        yield print_stages(lambda _, stage, _note: f"{title}: {stage}")
        return
    from rich.progress import Progress, TextColumn, TimeElapsedColumn

    *usual, remaining = Progress.get_default_columns()
    note = TextColumn("{task.fields[note]}")
    columns = (*usual, TimeElapsedColumn(), remaining, note)
    with Progress(*columns, console=console) as bars:
        bar = bars.add_task(title, total=1.0, note="")

        def on_progress(share: float, stage: str, note: str = "") -> None:
            bars.update(bar, completed=share, description=stage or title, note=note)

        yield on_progress


def print_stages(
    describe: Callable[[float, str, str], str], *, steps: int = 0
) -> NotedProgress:
    """Callback that prints a line per stage, and one at each step of its fraction."""
    last = ("", 0)

    def on_progress(share: float, stage: str, note: str = "") -> None:
        nonlocal last
        now = (stage, int(steps * share))
        if stage and now != last:
            say(describe(share, stage, note))
            last = now

    return on_progress


def say(text: str) -> None:
    """Write a line to standard error."""
    print(text, file=sys.stderr, flush=True)


def print_json(summary: Mapping[str, Any]) -> None:
    """Write one JSON object to standard output; paths become strings."""
    text = json.dumps(summary, indent=1, allow_nan=False, default=os.fspath)
    print(text, flush=True)


def print_table(
    title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]
) -> None:
    """Write a table to standard output: names left, numbers right."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title, title_justify="left")
    for number, name in enumerate(columns):
        table.add_column(name, justify="left" if number == 0 else "right")
    for row in rows:
        table.add_row(*row)
    Console().print(table)


def list_files(folder: Path) -> list[Path]:
    """Files of a folder, sorted."""
    return sorted(path for path in folder.iterdir() if path.is_file())


def print_files(files: Iterable[Path | str]) -> None:
    """Write paths to standard output, one per line."""
    for file in files:
        print(file)


def require_folder(output: Path, content: str) -> None:
    """Raise BadInput where a file is in the place of an output folder."""
    if output.exists() and not output.is_dir():
        raise BadInput(f"{output}: is a file; name a folder for {content}")


@contextmanager
def open_client(
    address: str, key_file: Path | None, ca_file: Path | None = None
) -> Iterator[Client]:
    """Yield a client of the service; refusals become errors of a command.

    Raises BadInput for errors of the request, JobError for all else.
    """
    from truepath.client import Client, ClientError, Problem

    if not address.startswith(("http://", "https://")):
        raise BadInput(f"--address {address}: write http://HOST:PORT or https://…")
    token = key_file.read_text(encoding="utf-8").strip() if key_file else None
    if ca_file is not None and not ca_file.is_file():
        raise BadInput(f"--ca-file {ca_file}: is no file")
    try:
        with Client(address, token=token, verify=ca_file) as client:
            yield client
    except Problem as error:
        kind = BadInput if error.status in (404, 422) else JobError
        raise kind(str(error)) from error
    except ClientError as error:
        raise JobError(str(error)) from error
