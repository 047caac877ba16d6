"""Models of the machine, one a job that has made one: where they are, how they grew."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from truepath.errors import NotFound

MODEL, RESULT, DISCOVERY = "model.json", "result.json", "discovery.json"


def find_model_file(results: Path, job_id: str) -> Path:
    """Return the model of a discovery, or the result of an analysis.

    Raises NotFound if the job has left neither.
    """
    for name in (MODEL, RESULT):
        file = results / job_id / name
        if file.is_file():
            return file
    raise NotFound(f"job {job_id} has no model and no result")


def read_growth(results: Path, job_id: str) -> Mapping[str, Any]:
    """Return version, parent and difference of a model with the effects found.

    Raises NotFound if the job has found none.
    """
    file = results / job_id / DISCOVERY
    if not file.is_file():
        raise NotFound(f"job {job_id} has no model")
    content = json.loads(file.read_text(encoding="utf-8"))
    return {**content["model"], "effects": content["effects"], "gap": content["gap"]}


def read_versions(results: Path, job_id: str) -> list[tuple[str, Mapping[str, Any]]]:
    """Return a model and those it came from, the newest first, as far as they stand."""
    found = [(job_id, read_growth(results, job_id))]
    seen = {job_id}
    while True:
        source = str(found[-1][1]["parent"]["source"])
        if source in seen or not (results / source / DISCOVERY).is_file():
            return found
        found.append((source, read_growth(results, source)))
        seen.add(source)


def read_difference(before: Path, after: Path) -> list[dict[str, str]]:
    """Return what differs between two model or result files. Raises BundleError."""
    # Imported where it computes: the service itself carries no science.
    from truepath.answers.comparison.model_difference import list_differences
    from truepath.files.earlier.result_file import read_result

    old, new = (read_result(file) for file in (before, after))
    changes = list_differences(old, new)
    return [asdict(change) for change in changes]
