"""The command line: its commands, and mapping of errors to exit statuses."""

from __future__ import annotations

import gc
import io
import os
import sys
from collections.abc import Callable, Sequence
from typing import Annotated, NoReturn

import typer

from truepath.cli import (
    analysis_commands,
    driver_commands,
    import_command,
    machine_commands,
    machine_file_command,
    operation_commands,
    planning_commands,
    result_commands,
    service_commands,
    trend_commands,
    user_commands,
)
from truepath.errors import BadInput, TruepathError
from truepath.thread_limits import choose_thread_limits
from truepath_drivers.interfaces.errors import DeviceError

SUCCESS, FAILURE, BAD_INPUT = 0, 1, 2
_CTRL_C = 130  # as Typer answers it

app = typer.Typer(
    help="Calibrates machine tools with a laser tracker, with the machine in the loop.",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def main() -> NoReturn:
    """Run the command line of this process and exit with its status.

    No command has imported NumPy yet, which reads the limits at its import.
    """
    os.environ.update(choose_thread_limits())
    if isinstance(sys.stdout, io.TextIOWrapper):  # a terminal of few letters: LANG=C
        sys.stdout.reconfigure(errors="backslashreplace")
    sys.exit(run(sys.argv[1:]))


def run(arguments: Sequence[str]) -> int:
    """Exit status of one command line: 0, 2 for bad input, else 1."""
    args = list(arguments) or ["--help"]
    return run_command(lambda: app(args=args, standalone_mode=False))


def _print_version(asked: bool) -> None:
    if asked:
        from importlib.metadata import version  # reads mail headers: slow to import

        print(version("truepath"))
        raise typer.Exit


@app.callback()
def truepath(
    context: typer.Context,
    version: Annotated[
        bool,
        typer.Option("--version", callback=_print_version, help="Print the version."),
    ] = False,
) -> None:
    """Calibrates machine tools with a laser tracker, with the machine in the loop."""
    if context.invoked_subcommand not in ("serve", "simulate", "record"):
        # Imports make many objects that stay; scanning them repeatedly costs a
        # twentieth of the time of a command that soon ends.
        gc.set_threshold(100_000, 50, 50)


# In the order in which --help lists them: as they are used.
app.command()(service_commands.serve)
app.command()(service_commands.demo)
app.command()(driver_commands.drivers)
app.command()(driver_commands.formats)
app.command()(driver_commands.effects)
app.command()(driver_commands.plugins)
app.command(
    # All words, --help among them, go to the simulators' own command line.
    context_settings={
        "allow_extra_args": True,
        "ignore_unknown_options": True,
        "help_option_names": [],
    }
)(service_commands.simulate)
app.command()(analysis_commands.analyse)
app.command()(analysis_commands.discover)
app.command()(planning_commands.grade)
app.command()(analysis_commands.predict)
app.command()(result_commands.compare)
app.command()(result_commands.verify)
app.command()(result_commands.export)
app.command()(result_commands.certificate)
app.command()(trend_commands.trend)
app.command()(trend_commands.temperature)
app.command()(analysis_commands.reanalyse)
app.command()(planning_commands.plan)
app.command()(service_commands.record)
app.command("import")(import_command.import_recording)
app.command()(operation_commands.doctor)
app.command()(operation_commands.backup)
app.command()(operation_commands.restore)
app.command()(operation_commands.support_bundle)
app.command()(operation_commands.settings)
app.command()(operation_commands.systemd_unit)
app.add_typer(machine_file_command.machine, name="machine")
app.add_typer(machine_commands.machines, name="machines")
app.add_typer(operation_commands.catalogue, name="catalogue")
app.add_typer(operation_commands.tls, name="tls")
app.add_typer(user_commands.users, name="users")
app.add_typer(user_commands.keys, name="keys")
app.add_typer(user_commands.audit, name="audit")


def run_command(call: Callable[[], int | None]) -> int:
    """Exit status of a command; a failure is printed in one line.

    Only errors that a user can remedy are caught. Any other is a defect of the program:
    it passes through with its traceback.
    """
    try:
        return _map_status(call() or SUCCESS)
    except typer.TyperException as error:
        return _print_failure(error.format_message(), error.exit_code)
    except BadInput as error:
        return _print_failure(str(error), BAD_INPUT)
    except (TruepathError, DeviceError) as error:
        return _print_failure(str(error) or type(error).__name__, FAILURE)
    except OSError as error:
        return _report_file(error)
    except (KeyboardInterrupt, typer.Abort):
        return _map_status(_CTRL_C)


def _map_status(status: int) -> int:
    if status == _CTRL_C:
        return _print_failure("interrupted", FAILURE)
    return status if status in (SUCCESS, BAD_INPUT) else FAILURE


def _report_file(error: OSError) -> int:
    """A missing file or one without permission is bad input; a full disk is not."""
    if error.filename is None or not error.strerror:
        raise error
    mistaken = FileNotFoundError | FileExistsError | PermissionError
    mistaken |= IsADirectoryError | NotADirectoryError
    status = BAD_INPUT if isinstance(error, mistaken) else FAILURE
    return _print_failure(f"{error.filename}: {error.strerror}", status)


def _print_failure(text: str, status: int) -> int:
    print(f"truepath: {' '.join(text.split())}", file=sys.stderr, flush=True)
    return status
