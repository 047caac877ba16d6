"""From an error to one line on standard error and an exit status."""

from __future__ import annotations

import sys
from collections.abc import Callable

import typer

from app.errors import BadInput, TruepathError
from drivers.interfaces.errors import DeviceError

SUCCESS, FAILURE, BAD_INPUT = 0, 1, 2
_CTRL_C = 130  # as Typer answers it


def run_command(call: Callable[[], int | None]) -> int:
    """Run a command; say in one line why it failed, and return its exit status.

    What is caught here is what a user can do something about. Anything else is a fault
    of the program: it passes through with its traceback.
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
    """A file that is not there or not ours to use is bad input; a full disk is not."""
    if error.filename is None or not error.strerror:
        raise error
    mistaken = (
        FileNotFoundError,
        FileExistsError,
        IsADirectoryError,
        NotADirectoryError,
        PermissionError,
    )
    status = BAD_INPUT if isinstance(error, mistaken) else FAILURE
    return _print_failure(f"{error.filename}: {error.strerror}", status)


def _print_failure(text: str, status: int) -> int:
    print(f"truepath: {' '.join(text.split())}", file=sys.stderr, flush=True)
    return status
