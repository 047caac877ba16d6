"""The computer: versions, clock, memory, threads of linear algebra."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path

from packaging.requirements import Requirement

from truepath.operation.finding import Finding, Grade

LEAST_MEMORY_BYTES = 1 << 30
_MADE = datetime(2026, 1, 1, tzinfo=UTC)  # a clock before that was never set
_ASK_S = 5.0


def check_computer() -> Iterator[Finding]:
    """Versions, clock, memory and threads."""
    yield check_versions()
    yield check_clock()
    yield check_memory(Path("/proc/meminfo"))
    yield check_threads()


def check_versions() -> Finding:
    """Whether the libraries have the versions that this package requires."""
    python = ".".join(map(str, sys.version_info[:3]))
    ours = f"Truepath {version('truepath')}, Python {python}"
    wrong = list(_list_wrong_versions())
    if not wrong:
        return Finding("versions", Grade.OK, ours)
    text = f"{ours}; {'; '.join(wrong)}"
    remedy = "install again with the constraints: pip install -c constraints.txt ."
    return Finding("versions", Grade.WRONG, text, remedy)


def _list_wrong_versions() -> Iterator[str]:
    for line in requires("truepath") or ():
        need = Requirement(line)
        if need.marker is not None and not need.marker.evaluate({"extra": ""}):
            continue
        try:
            found = version(need.name)
        except PackageNotFoundError:
            yield f"{need.name} is missing"
            continue
        if not need.specifier.contains(found, prereleases=True):
            yield f"{need.name} is {found}, not {need.specifier}"


def check_clock(now: datetime | None = None) -> Finding:
    """Whether the clock is set and synchronised, as far as the system reports it."""
    now = now or datetime.now(UTC)
    shown = f"{now:%Y-%m-%d %H:%M:%S} UTC"
    if now < _MADE:
        remedy = "set the date: Runs and results bear it"
        return Finding("clock", Grade.WRONG, f"{shown} is before this version", remedy)
    kept = _is_clock_kept()
    if kept is None:
        return Finding("clock", Grade.UNTOLD, f"{shown}; nobody says who keeps it")
    if kept:
        return Finding("clock", Grade.OK, f"{shown}, kept by the network")
    remedy = "switch time synchronisation on (timedatectl set-ntp true), or set it"
    return Finding("clock", Grade.WARNING, f"{shown}, kept by nobody", remedy)


def _is_clock_kept() -> bool | None:
    program = shutil.which("timedatectl")
    if program is None:
        return None
    try:
        told = subprocess.run(  # noqa: S603
            [program, "show", "--property=NTPSynchronized", "--value"],
            capture_output=True,
            text=True,
            timeout=_ASK_S,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return {"yes": True, "no": False}.get(told.stdout.strip())


def check_memory(meminfo: Path) -> Finding:
    """Whether there is memory for an analysis; `meminfo` as Linux writes it."""
    try:
        lines = meminfo.read_text(encoding="ascii").splitlines()
        told = dict(line.split(":", 1) for line in lines)
        free = int(told["MemAvailable"].split()[0]) << 10
    except (OSError, KeyError, ValueError):
        return Finding("memory", Grade.UNTOLD, "the system does not tell")
    text = f"{free / 1e9:.1f} GB are free"
    if free >= LEAST_MEMORY_BYTES:
        return Finding("memory", Grade.OK, text)
    remedy = "end other programs: an analysis of a long Run takes about 1 GB"
    return Finding("memory", Grade.WARNING, text, remedy)


def check_threads() -> Finding:
    """Whether linear algebra is limited to one thread per process."""
    several = {
        name: value
        for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
        if (value := os.environ.get(name, "1")) != "1"
    }
    if not several:
        return Finding("threads", Grade.OK, "linear algebra: one thread a process")
    text = ", ".join(f"{name}={value}" for name, value in several.items())
    remedy = "leave them unset: several threads a process wait for each other"
    return Finding("threads", Grade.WARNING, text, remedy)
