"""A task about Runs, called only where their files are as catalogued."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from truepath.errors import BundleError
from truepath.jobs.workers.executor import Task
from truepath.measurement.run_file.run_file import hash_file
from truepath.progress import Progress

_SHOWN = 12  # digits of a digest


@dataclass(frozen=True, slots=True)
class OfUnchangedRuns:
    """A task that first compares each file with its SHA-256.

    Raises BundleError where one has been changed since it was catalogued.

    sha256 : of the catalogue, by file
    """

    task: Task
    sha256: Mapping[str, str]

    def __call__(self, *arguments: object, on_progress: Progress) -> Any:
        """Call the task, in the process that reads the files."""
        for file, sha256 in self.sha256.items():
            _require_unchanged(Path(file), sha256)
        return self.task(*arguments, on_progress=on_progress)


def _require_unchanged(file: Path, sha256: str) -> None:
    now = hash_file(file)
    if now != sha256:
        raise BundleError(
            f"has been changed since it was catalogued: its SHA-256 is now "
            f"{now[:_SHOWN]}…, and was {sha256[:_SHOWN]}…",
            file=file.name,
            remedy="put the file back from a backup, or upload the bundle as a Run of "
            "its own",
        )
