"""The commands on the catalogue of a data folder: `catalogue check` and `rebuild`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from truepath.cli.terminal import Config, DataDir, Json, print_json, say

if TYPE_CHECKING:
    from truepath.settings import Settings

catalogue = typer.Typer(
    help="Look at the catalogue of jobs and Runs, or make it again.",
    no_args_is_help=True,
)


@catalogue.command()
def check(
    config: Config = None,
    data_dir: DataDir = None,
    with_hashes: Annotated[
        bool,
        typer.Option("--hash", help="Read every Run: was it changed since?"),
    ] = False,
    json: Json = False,
) -> None:
    """Whether the catalogue can be used, and agrees with the Runs on disk."""
    settings = _load(config, data_dir)
    from truepath.catalogue.store.database import Database
    from truepath.jobs.dispatch.catalogue_rebuild import check_against_disk

    database = Database(settings.database)
    try:
        found = check_against_disk(
            database, settings.data_dir / "runs", with_hashes=with_hashes
        )
    finally:
        database.close()
    if json:
        print_json({"schema": "catalogue-check/1", **found})
        return
    place = database.file or "catalogue"
    if found["revision"] is None:
        print(f"{place}: there is none yet")
        return
    print(
        f"{place}: in order, schema {found['revision']}, {found['jobs']} jobs, "
        f"{found['runs']} Runs"
    )
    for run_id in found["runs_without_row"]:
        say(f"Run {run_id} is on disk and in no row; the service adds it by itself")
    for run_id in found["rows_without_file"]:
        say(f"Run {run_id} is in the catalogue and its file has gone")
    for run_id in found["changed_files"] or ():
        say(f"Run {run_id} was changed since it was catalogued: SHA-256 differs")


@catalogue.command()
def rebuild(
    config: Config = None, data_dir: DataDir = None, json: Json = False
) -> None:
    """Set a damaged catalogue aside and make it again from Runs and results on disk.

    A whole one stays and gets what it lacks. The service must not run meanwhile.
    """
    settings = _load(config, data_dir)
    from dataclasses import asdict

    from truepath.catalogue.data_dir_lock import hold_folder
    from truepath.catalogue.store.database import Database
    from truepath.jobs.dispatch.catalogue_rebuild import rebuild_catalogue

    folder = settings.data_dir
    with hold_folder(folder):
        database = Database(settings.database)
        try:
            found = rebuild_catalogue(database, folder / "runs", folder / "results")
        finally:
            database.close()
    if json:
        print_json({"schema": "catalogue-rebuild/1", **asdict(found)})
        return
    if found.aside is not None:
        print(f"the damaged catalogue is kept as {found.aside}")
    print(
        f"added: {found.runs} Runs, {found.jobs} jobs ({found.results} with what they "
        f"found, {found.models} models)"
    )
    for what, why in found.unreadable.items():
        say(f"{what}: {why}; its file is kept")


def _load(config: Path | None, data_dir: Path | None) -> Settings:
    from truepath.service_log import configure_log
    from truepath.settings import load_settings

    configure_log("warning", "console")
    return load_settings(config, data_dir=data_dir)
