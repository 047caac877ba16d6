"""The command that writes a certificate for the owner of the machine."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Annotated, Literal

import typer

from truepath.cli.terminal import ResultFile, collect_garbage_rarely, print_files, say
from truepath.errors import BadInput, NotUsable

_SUFFIXES = (".pdf", ".html")


def certificate(
    result: ResultFile,
    output: Annotated[
        Path,
        typer.Option("--output", "-o", metavar="FILE", help=".pdf or .html to write."),
    ],
    as_left: Annotated[
        Path | None,
        typer.Option(metavar="RESULT.json", help="Measured after compensation."),
    ] = None,
    verification: Annotated[
        Path | None, typer.Option(metavar="V.json", help="What `verify` wrote.")
    ] = None,
    compensation: Annotated[
        Path | None,
        typer.Option(metavar="ACCOUNT.json", help="What `export` wrote beside files."),
    ] = None,
    identity: Annotated[
        Path | None,
        typer.Option(metavar="FILE.json", help="Serial numbers, operator, customer …"),
    ] = None,
    state: Annotated[
        list[str] | None,
        typer.Option(metavar="FIELD=TEXT", help="One field of the identity."),
    ] = None,
    language: Annotated[Literal["en", "de"], typer.Option()] = "en",
    number: Annotated[
        str, typer.Option(help="Of the certificate; else made from the result.")
    ] = "",
    issued: Annotated[
        datetime | None,
        typer.Option(formats=["%Y-%m-%d"], help="Date of issue; today if left out."),
    ] = None,
    accept_verdict: Annotated[
        bool,
        typer.Option(
            "--accept-verdict",
            help="Issue one for a result that is not to be used all the same.",
        ),
    ] = False,
) -> None:
    """A calibration certificate of a result, as PDF or HTML."""
    collect_garbage_rarely()
    from truepath.answers.certificate.document import render_certificate
    from truepath.answers.certificate.issue import (
        gather_certificate,
        read_result_source,
    )
    from truepath.answers.certificate.pdf import require_printer

    suffix = output.suffix.lower()
    if suffix not in _SUFFIXES:
        raise BadInput(f"{output}: write a name that ends in {' or '.join(_SUFFIXES)}")
    if suffix == ".pdf":
        require_printer()
    found = read_result_source(result)
    stated = _read_stated(identity, state or [])
    content = gather_certificate(
        found,
        issued=issued.date() if issued else datetime.now().astimezone().date(),
        left=as_left,
        verification=verification,
        compensation=compensation,
        identity=stated,
        language=language,
        number=number,
    )
    try:
        html = render_certificate(content, accept_verdict=accept_verdict)
    except NotUsable as error:
        remedy = "--accept-verdict issues it all the same"
        raise BadInput(f"{error} {remedy}") from error
    _write(output, html)
    _describe_missing(stated)
    print_files([output])


def _read_stated(file: Path | None, state: list[str]) -> Mapping[str, str]:
    from truepath.files.bundle.identity_file import read_assignments, read_identity

    return {**(read_identity(file) if file else {}), **read_assignments(state)}


def _write(output: Path, html: str) -> None:
    from truepath.answers.certificate.pdf import print_pdf
    from truepath.documents.whole_files import replace_file

    data = print_pdf(html) if output.suffix.lower() == ".pdf" else html.encode()
    output.parent.mkdir(parents=True, exist_ok=True)
    replace_file(output, data)


def _describe_missing(stated: Mapping[str, str]) -> None:
    from truepath.files.bundle.identity_file import FIELDS

    if missing := [name for name in FIELDS if name not in stated]:
        say(f"not stated: {', '.join(missing)}; state them with --state FIELD=TEXT")
