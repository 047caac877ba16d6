"""The commands of who operates the service: settings, unit of systemd, support."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from truepath.app.cli.terminal import Json, print_json, say
from truepath.app.errors import BadInput

Config = Annotated[
    Path | None, typer.Option("--config", metavar="FILE", help="Settings, as TOML.")
]
DataDir = Annotated[
    Path | None,
    typer.Option("--data-dir", metavar="DIR", help="Runs, results, catalogue."),
]


def settings(
    config: Config = None,
    data_dir: DataDir = None,
    example: Annotated[
        bool,
        typer.Option("--example", help="Print a settings file with all, commented."),
    ] = False,
) -> None:
    """The settings in effect, as TOML without secrets; or an example of all."""
    from truepath.app.operation.redaction import redact_settings
    from truepath.app.operation.settings_text import write_example, write_toml
    from truepath.app.settings import load_settings

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
    from truepath.app.operation.systemd_unit import UnitOrder, write_unit
    from truepath.app.settings import load_settings

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

    from truepath.app.operation.support_bundle import write_support_bundle
    from truepath.app.service_log import configure_log
    from truepath.app.settings import load_settings

    configure_log("error", "console")
    settings = load_settings(config, data_dir=data_dir)
    written = write_support_bundle(settings, output, int(max_mb * 1e6))
    if json:
        print_json({"schema": "support-bundle-summary/1", **asdict(written)})
        return
    print(f"{output}: {', '.join(written.parts)}")
    for name, why in written.missing.items():
        say(f"missing: {name}: {why}")
