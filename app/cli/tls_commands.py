"""`tls create`: a certificate of one's own, where there is no other."""

from __future__ import annotations

from typing import Annotated

import typer

from truepath.app.cli.catalogue_commands import Config, DataDir

tls = typer.Typer(help="Certificates for listening beyond this computer.")


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
    from truepath.app.settings import load_settings
    from truepath.app.users.certificates import create_certificate

    # The folder alone is needed: the settings may ask for what is made here.
    settings = load_settings(config, data_dir=data_dir, allow_plain_http=True)
    files = create_certificate(names, settings.data_dir / "tls", days)
    print(f'tls_cert = "{files.cert.resolve()}"')
    print(f'tls_key = "{files.key.resolve()}"')
