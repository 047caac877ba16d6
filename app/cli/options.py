"""What commands share: options with one wording each, checks, process settings."""

from __future__ import annotations

import gc
from pathlib import Path
from typing import Annotated

import typer

from app.errors import BadInput

Json = Annotated[
    bool, typer.Option("--json", help="Print the summary on standard output as JSON.")
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


def require_folder(output: Path, content: str) -> None:
    """Raise BadInput where a file is in the place of an output folder."""
    if output.exists() and not output.is_dir():
        raise BadInput(f"{output}: is a file; name a folder for {content}")


def compute_on_one_thread() -> None:
    """Keep linear algebra to one thread; call it before NumPy is imported.

    On busy cores the threads of a BLAS wait for each other and take several times the
    processor time of one.
    """
    from app.child_process import limit_own_threads

    limit_own_threads()
    # Imports make many objects that stay; looking through them again and again for
    # cycles costs a command that soon ends a twentieth of its time.
    gc.set_threshold(100_000, 50, 50)
