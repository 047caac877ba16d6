"""The command line: what it is called with, and which commands it has."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.metadata import version
from typing import Annotated, NoReturn

import typer

from app.cli import science_commands as science
from app.cli import service_commands as service
from app.cli.failures import exit_status

app = typer.Typer(
    help="Calibrates machine tools with a laser tracker, with the machine in the loop.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def main() -> NoReturn:
    """Run the command line of this process and exit with its status."""
    sys.exit(run(sys.argv[1:]))


def run(arguments: Sequence[str]) -> int:
    """Run one command line and return its exit status: 0, 2 for bad input, else 1."""
    return exit_status(lambda: app(args=list(arguments), standalone_mode=False))


def _print_version(asked: bool) -> None:
    if asked:
        print(version("truepath"))
        raise typer.Exit


@app.callback()
def truepath(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_print_version, help="Print the version."),
    ] = False,
) -> None:
    """Calibrates machine tools with a laser tracker, with the machine in the loop."""


# In the order in which --help lists them: as they are used.
app.command()(service.serve)
app.command()(service.demo)
app.command(
    # All words, --help among them, go to the simulators' own command line.
    context_settings={
        "allow_extra_args": True,
        "ignore_unknown_options": True,
        "help_option_names": [],
    }
)(service.simulate)
app.command()(science.analyse)
app.command()(science.discover)
app.command()(science.grade)
app.command()(science.predict)
app.command()(science.compare)
app.command()(science.export)
app.command()(science.plan)
app.command()(service.record)
