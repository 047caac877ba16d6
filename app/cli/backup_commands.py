"""`truepath backup` and `truepath restore`: the data folder, kept and put back."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from truepath.app.cli.operation_commands import Config, DataDir
from truepath.app.cli.terminal import Json, print_json, say

if TYPE_CHECKING:
    from truepath.app.operation.backup import Kept
    from truepath.app.settings import Settings


def backup(
    output: Annotated[
        Path,
        typer.Option(
            "--output", "-o", metavar="PLACE", help="A new folder, or FILE.zip."
        ),
    ],
    config: Config = None,
    data_dir: DataDir = None,
    json: Json = False,
) -> None:
    """Keep catalogue, users, Runs and results; the service may go on measuring.

    A Run that is being recorded is left out and named.
    """
    from truepath.app.operation.backup import make_backup

    kept = make_backup(_load(config, data_dir), output)
    if json:
        print_json({"schema": "backup-summary/1", **_summarise(kept)})
        return
    print(f"{output}: {_describe(kept)}")
    for name, why in kept.left_out.items():
        say(f"left out: {name}: {why}")


def restore(
    place: Annotated[
        Path, typer.Argument(metavar="BACKUP", help="What `backup` has written.")
    ],
    config: Config = None,
    data_dir: DataDir = None,
    force: Annotated[
        bool, typer.Option("--force", help="Move data that are there aside.")
    ] = False,
    json: Json = False,
) -> None:
    """Check a backup and put it into a data folder; no service may run on it."""
    from truepath.app.operation.backup import restore_backup

    settings = _load(config, data_dir)
    kept = restore_backup(settings, place, force=force)
    if json:
        print_json({"schema": "restore-summary/1", **_summarise(kept)})
        return
    print(f"{settings.data_dir}: {_describe(kept)}")
    for name in kept.left_out:
        say(f"was left out of the backup: {name}")


def _describe(kept: Kept) -> str:
    rows = ", ".join(f"{kept.rows.get(name, 0)} {name}" for name in ("jobs", "runs"))
    return f"{rows}, {len(kept.files)} files, {kept.bytes / 1e6:.1f} MB"


def _summarise(kept: Kept) -> dict[str, object]:
    return {
        "revision": kept.revision,
        "rows": dict(kept.rows),
        "files": len(kept.files),
        "bytes": kept.bytes,
        "left_out": dict(kept.left_out),
    }


def _load(config: Path | None, data_dir: Path | None) -> Settings:
    from truepath.app.service_log import configure_log
    from truepath.app.settings import load_settings

    configure_log("warning", "console")
    return load_settings(config, data_dir=data_dir)
