"""Common part of the commands that use a running service over REST."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from truepath.errors import BadInput, JobError

if TYPE_CHECKING:
    from truepath.client import Client

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
_MISTAKEN = (404, 422)


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
        kind = BadInput if error.status in _MISTAKEN else JobError
        raise kind(str(error)) from error
    except ClientError as error:
        raise JobError(str(error)) from error
