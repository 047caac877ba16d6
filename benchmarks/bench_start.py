"""Processor time to start: of the service, and of --help, beside their libraries'."""

from __future__ import annotations

import resource
import subprocess
import sys

TRIES = 5
SERVICE = "import truepath.main"
HELP = "from truepath.cli.command import run; run(['--help'])"
LIST_LIBRARIES = f"""
import sys
{SERVICE}
outside = sys.stdlib_module_names | {{"truepath", "truepath_drivers", "__main__"}}
print(*(name for name in sys.modules if name.split(".")[0] not in outside))
"""
IMPORT = """
import importlib
for name in {names}:
    try: importlib.import_module(name)
    except ImportError: pass  # one that a library makes as it is loaded
"""


def main() -> None:
    names = _run(LIST_LIBRARIES).split()
    libraries_s = _processor_s(IMPORT.format(names=names))
    service_s = _processor_s(SERVICE)
    print(f"service {service_s:.2f} s, its libraries {libraries_s:.2f} s", end="")
    print(f": {service_s / libraries_s:.2f} times (at most 2)")
    typer_s, help_s = _processor_s("import typer.rich_utils"), _processor_s(HELP)
    print(f"--help {help_s:.2f} s, Typer {typer_s:.2f} s", end="")
    print(
        f": {help_s / typer_s:.2f} times, {help_s - typer_s:.2f} s more (at most 0.3)"
    )


def _processor_s(program: str) -> float:
    return min(_measure_s(program) for _ in range(TRIES))


def _measure_s(program: str) -> float:
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    _run(program)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


def _run(program: str) -> str:
    command = [sys.executable, "-c", program]
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout


if __name__ == "__main__":
    main()
