"""`truepath doctor`: what is wrong with an installation, and what to do."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from truepath.app.cli.terminal import Json, print_json

_MARKS = {"ok": "ok", "untold": "?", "warning": "warning", "wrong": "WRONG"}


def doctor(
    config: Annotated[
        Path | None, typer.Option("--config", metavar="FILE", help="Settings, as TOML.")
    ] = None,
    data_dir: Annotated[
        Path | None,
        typer.Option("--data-dir", metavar="DIR", help="Runs, results, catalogue."),
    ] = None,
    json: Json = False,
) -> int:
    """Look at devices, ports, clock, disk, rights, versions; say what to do.

    Moves nothing. Where a service runs it is asked in place of its devices. The exit
    status is 1 where something is wrong.
    """
    from dataclasses import asdict

    from truepath.app.operation.doctor import examine
    from truepath.app.operation.finding import Grade
    from truepath.app.service_log import configure_log
    from truepath.app.settings import load_settings

    configure_log("error", "console")
    found = []
    for one in examine(load_settings(config, data_dir=data_dir)):
        found.append(one)
        if not json:
            print(f"{_MARKS[one.grade]:8} {one.subject:12} {one.text}")
            if one.remedy:
                print(f"{'':22}-> {one.remedy}")
    is_wrong = any(one.grade is Grade.WRONG for one in found)
    if json:
        findings = [asdict(one) for one in found]
        print_json({"schema": "doctor/1", "good": not is_wrong, "findings": findings})
    return int(is_wrong)
