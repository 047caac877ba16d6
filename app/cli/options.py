"""Options and arguments that several commands share, with one wording each."""

from __future__ import annotations

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
