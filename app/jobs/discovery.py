"""Discovery as a job does it: a Run in; what its model lacks, as files, out."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from app.discovery.discover import Discovery, discover
from app.discovery.discovery_json import discovery_json
from app.jobs.analysis import Progress
from app.measurement.bundle_files import replace_file
from app.measurement.run import Run

DISCOVERY = "discovery.json"


@dataclass(frozen=True, slots=True)
class Discovered:
    """What became of one Run; content : of `discovery.json`."""

    found: Discovery
    content: dict[str, Any]


def discover_run(run: Run, progress: Progress | None = None) -> Discovered:
    """Find what the rigid-body model fitted to a Run lacks.

    progress : told the share done and the stage

    Raises AlignmentError, EstimationError if the Run cannot be fitted.
    """

    def told(share: float) -> None:
        if progress is not None:
            progress(share, "discovering")

    found = discover(run, progress=told)
    return Discovered(found, discovery_json(found))


def write_discovery(discovered: Discovered, folder: str | Path) -> None:
    """Write the files of a discovery into a folder, each whole or not at all."""
    place = Path(folder)
    place.mkdir(parents=True, exist_ok=True)
    text = json.dumps(discovered.content, ensure_ascii=False, allow_nan=False)
    replace_file(place / DISCOVERY, f"{text}\n".encode())
