"""The commands of who operates the service: settings and the unit for systemd."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

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
