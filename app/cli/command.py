"""The command line: what it is called with, and which commands it has."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.metadata import version
from typing import Annotated, NoReturn

import typer

from app.cli import (
    analysis_commands,
    discovery_commands,
    planning_commands,
    result_commands,
    service_commands,
)
from app.cli.failures import run_command

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
    return run_command(lambda: app(args=list(arguments), standalone_mode=False))


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
app.command()(service_commands.serve)
app.command()(service_commands.demo)
app.command(
    # All words, --help among them, go to the simulators' own command line.
    context_settings={
        "allow_extra_args": True,
        "ignore_unknown_options": True,
        "help_option_names": [],
    }
)(service_commands.simulate)
app.command()(analysis_commands.analyse)
app.command()(discovery_commands.discover)
app.command()(planning_commands.grade)
app.command()(analysis_commands.predict)
app.command()(result_commands.compare)
app.command()(result_commands.export)
app.command()(planning_commands.plan)
app.command()(service_commands.record)
