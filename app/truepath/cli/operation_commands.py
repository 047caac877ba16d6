"""The commands for operating the service: settings, systemd, TLS, doctor, backup,
catalogue.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from truepath.cli.terminal import Config, DataDir, Json, print_json, say
from truepath.errors import BadInput

if TYPE_CHECKING:
    from truepath.operation.backup import BackupContent
    from truepath.settings import Settings


_MARKS = {"ok": "ok", "untold": "?", "warning": "warning", "wrong": "WRONG"}
tls = typer.Typer(help="Certificates for listening beyond this computer.")
catalogue = typer.Typer(
    help="Look at the catalogue of jobs and Runs, or make it again.",
    no_args_is_help=True,
)


def settings(
    config: Config = None,
    data_dir: DataDir = None,
    example: Annotated[
        bool,
        typer.Option("--example", help="Print a settings file with all, commented."),
    ] = False,
) -> None:
    """The settings in effect, as TOML without secrets; or an example of all."""
    from truepath.operation.settings_text import (
        redact_settings,
        write_example,
        write_toml,
    )
    from truepath.settings import load_settings

    if example:
        print(write_example(), end="")
        return
    for name, value in redact_settings(load_settings(config, data_dir=data_dir)):
        if value is not None:
            print(f"{name} = {write_toml(value)}")


def systemd_unit(
    config: Config = None,
    data_dir: DataDir = None,
    user: Annotated[
        str, typer.Option(help="Account of the service.", metavar="NAME")
    ] = "truepath",
) -> None:
    """A unit for systemd that starts and watches the service, on standard output."""
    from truepath.operation.systemd_unit import UnitOrder, write_unit
    from truepath.settings import load_settings

    if not user.replace("-", "").replace("_", "").isalnum():
        raise BadInput(f"--user {user!r}: is no name of an account")
    settings = load_settings(config)
    folder = data_dir or (
        settings.data_dir
        if "data_dir" in settings.model_fields_set
        else Path("/var/lib/truepath")
    )
    log_file = settings.log_file
    order = UnitOrder(
        program=Path(sys.executable).with_name("truepath"),
        config=config.absolute() if config else None,
        data_dir=folder.absolute(),
        log_dir=log_file.absolute().parent if log_file else None,
        user=user,
    )
    print(write_unit(order), end="")


def support_bundle(
    output: Annotated[
        Path,
        typer.Option("--output", "-o", metavar="FILE.zip", help="A new zip file."),
    ],
    config: Config = None,
    data_dir: DataDir = None,
    max_mb: Annotated[
        float, typer.Option(min=1.0, max=1000.0, help="Of all, before it is packed.")
    ] = 20.0,
    json: Json = False,
) -> None:
    """Logs, versions, findings, last jobs, metrics; no password, key or token.

    Whether the service runs or not. Look through it before you send it.
    """
    from dataclasses import asdict

    from truepath.operation.support_bundle import write_support_bundle
    from truepath.service_log import configure_log
    from truepath.settings import load_settings

    configure_log("error", "console")
    settings = load_settings(config, data_dir=data_dir)
    written = write_support_bundle(settings, output, int(max_mb * 1e6))
    if json:
        print_json({"schema": "support-bundle-summary/1", **asdict(written)})
        return
    print(f"{output}: {', '.join(written.parts)}")
    for name, why in written.missing.items():
        say(f"missing: {name}: {why}")


def doctor(config: Config = None, data_dir: DataDir = None, json: Json = False) -> int:
    """Look at devices, ports, clock, disk, rights, versions; say what to do.

    Moves nothing. Where a service runs it is asked in place of its devices. The exit
    status is 1 where something is wrong.
    """
    from dataclasses import asdict

    from truepath.operation.doctor import Grade, examine
    from truepath.service_log import configure_log
    from truepath.settings import load_settings

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


@tls.callback()
def _tls() -> None:
    """Certificates for listening beyond this computer."""


@tls.command()
def create(
    names: Annotated[
        list[str],
        typer.Argument(
            metavar="NAME...", help="Names and addresses others call this computer by."
        ),
    ],
    days: Annotated[
        int, typer.Option(min=1, max=3650, help="How long it holds.")
    ] = 397,
    config: Config = None,
    data_dir: DataDir = None,
) -> None:
    """Make a self-signed certificate in the data folder, and print its settings."""
    from truepath.settings import load_settings
    from truepath.users.tls import create_certificate

    # The folder alone is needed: the settings may ask for what is made here.
    settings = load_settings(config, data_dir=data_dir, allow_plain_http=True)
    files = create_certificate(names, settings.data_dir / "tls", days)
    print(f'tls_cert = "{files.cert.resolve()}"')
    print(f'tls_key = "{files.key.resolve()}"')


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
    from truepath.operation.backup import make_backup

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
    from truepath.operation.backup import restore_backup

    settings = _load(config, data_dir)
    kept = restore_backup(settings, place, force=force)
    if json:
        print_json({"schema": "restore-summary/1", **_summarise(kept)})
        return
    print(f"{settings.data_dir}: {_describe(kept)}")
    for name in kept.left_out:
        say(f"was left out of the backup: {name}")


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
    from truepath.catalogue.database import Database
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

    from truepath.catalogue.database import Database
    from truepath.catalogue.locks import hold_folder
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


def _describe(kept: BackupContent) -> str:
    rows = ", ".join(f"{kept.rows.get(name, 0)} {name}" for name in ("jobs", "runs"))
    return f"{rows}, {len(kept.files)} files, {kept.bytes / 1e6:.1f} MB"


def _summarise(kept: BackupContent) -> dict[str, object]:
    return {
        "revision": kept.revision,
        "rows": dict(kept.rows),
        "files": len(kept.files),
        "bytes": kept.bytes,
        "left_out": dict(kept.left_out),
    }


def _load(config: Path | None, data_dir: Path | None) -> Settings:
    from truepath.service_log import configure_log
    from truepath.settings import load_settings

    configure_log("warning", "console")
    return load_settings(config, data_dir=data_dir)
