"""Discovery as a job does it: Runs in; what their model lacks, as files, out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from app.discovery.discover import Discovery, discover
from app.discovery.open_questions import design_discrimination
from app.estimation.prior_model import PriorModel
from app.files.commanded_file import encode_commanded
from app.files.file_model import encode_json
from app.files.run import Run
from app.files.whole_files import replace_file
from app.planning.discrimination_lines import DiscriminationDesign
from app.progress import Progress, ignore_progress, scale_progress
from app.reporting.analysis_files import REPORT
from app.reporting.discovery_report import render_discovery_report
from app.results.discovery_json import discovery_json
from app.results.discrimination_json import ask_json
from app.results.model_file import NextModel, given_by, next_model

DISCOVERY, MODEL, ASK = "discovery.json", "model.json", "ask/path.csv"
_FOUND = 0.95  # share of the work that is done with the search


@dataclass(frozen=True, slots=True)
class Discovered:
    """What became of Runs; content : of `discovery.json`.

    asked : lines to drive next; None where nothing is left open
    """

    found: Discovery
    content: dict[str, Any]
    model: NextModel
    report_html: str
    asked: DiscriminationDesign | None


def discover_runs(
    runs: Sequence[Run],
    parent: PriorModel | None = None,
    on_progress: Progress = ignore_progress,
) -> Discovered:
    """Find what a model of Runs lacks.

    parent : the model; the rigid-body model fitted to the Runs if None
    on_progress : receives the share done and the stage: discovering, reporting

    Raises AlignmentError, EstimationError if the Runs cannot be fitted, BundleError if
    they, or the model, are not of one machine.
    """
    reference = None if parent is None else given_by(parent, runs[0])
    found = discover(
        runs, reference, scale_progress(on_progress, 0.0, _FOUND, "discovering")
    )
    on_progress(_FOUND, "reporting")
    model = next_model(found, parent)
    told_model = {k: model.content[k] for k in ("version", "parent", "difference")}
    content = {**discovery_json(found), "model": told_model}
    asked = design_discrimination(found)
    content["ask"] = None if asked is None else ask_json(asked, ASK)
    report = render_discovery_report(found, model, asked, ASK)
    return Discovered(found, content, model, report, asked)


def write_discovery(discovered: Discovered, folder: str | Path) -> None:
    """Write the files of a discovery into a folder, each whole or not at all."""
    place = Path(folder)
    place.mkdir(parents=True, exist_ok=True)
    replace_file(place / REPORT, discovered.report_html.encode())
    _write_ask(discovered, place / ASK)
    # The discovery last: where it stands, the others stand as well.
    for name, content in (
        (MODEL, discovered.model.content),
        (DISCOVERY, discovered.content),
    ):
        replace_file(place / name, encode_json(content))


def _write_ask(discovered: Discovered, file: Path) -> None:
    """Write the lines to drive next; where nothing is asked, nothing old stays."""
    if discovered.asked is None:
        file.unlink(missing_ok=True)
        return
    file.parent.mkdir(exist_ok=True)
    machine = discovered.found.aligned[0].run.machine
    replace_file(file, encode_commanded(discovered.asked.path, machine))
