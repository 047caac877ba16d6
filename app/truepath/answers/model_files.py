"""Models of a machine, one per job that made one: their files and their versions."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from truepath.errors import NotFound

MODEL, RESULT, DISCOVERY = "model.json", "result.json", "discovery.json"


def find_model_file(results: Path, job_id: str) -> Path:
    """The model of a discovery, or the result of an analysis.

    Raises NotFound if the job has neither.
    """
    for name in (MODEL, RESULT):
        file = results / job_id / name
        if file.is_file():
            return file
    raise NotFound(f"job {job_id} has no model and no result")


def read_model_summary(results: Path, job_id: str) -> Mapping[str, Any]:
    """Version, parent, difference, effects and gap of a discovered model.

    Raises NotFound if the job discovered none.
    """
    file = results / job_id / DISCOVERY
    if not file.is_file():
        raise NotFound(f"job {job_id} has no model")
    content = json.loads(file.read_text(encoding="utf-8"))
    return {**content["model"], "effects": content["effects"], "gap": content["gap"]}


def read_versions(results: Path, job_id: str) -> list[tuple[str, Mapping[str, Any]]]:
    """Job and content of a model and its ancestors, the newest first."""
    found = [(job_id, read_model_summary(results, job_id))]
    seen = {job_id}
    while True:
        source = str(found[-1][1]["parent"]["source"])
        if source in seen or not (results / source / DISCOVERY).is_file():
            return found
        found.append((source, read_model_summary(results, source)))
        seen.add(source)


def read_difference(before: Path, after: Path) -> list[dict[str, str]]:
    """Two model or result files, compared. Raises BundleError."""
    # Imported on use: the service process does not load the numerical code.
    from truepath.answers.model_difference import list_differences
    from truepath.files.earlier.result_file import read_result

    old, new = (read_result(file) for file in (before, after))
    changes = list_differences(old, new)
    return [asdict(change) for change in changes]
