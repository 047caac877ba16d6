"""From Runs to effects that their model lacks, the new model, and the next lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from truepath.answers.discovery.discovery_json import discovery_json, proposal_json
from truepath.answers.discovery.model_file import (
    NextModel,
    build_next_model,
    build_reference,
)
from truepath.discovery.discover import Discovery, discover
from truepath.discovery.discrimination import DiscriminationDesign
from truepath.discovery.open_questions import design_discrimination
from truepath.estimation.problem.prior_model import PriorModel
from truepath.files.bundle.run import Run
from truepath.progress import Progress, ignore_progress, scale_progress

ASK = "ask/path.csv"
_FOUND = 0.95  # share of the work that is done with the search


@dataclass(frozen=True, slots=True)
class Discovered:
    """Result of a discovery; content : of `discovery.json`.

    asked : lines to measure next, to be written as `ASK`; None if no question is open
    """

    found: Discovery
    content: dict[str, Any]
    model: NextModel
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
    reference = None if parent is None else build_reference(parent, runs[0])
    found = discover(
        runs, reference, scale_progress(on_progress, 0.0, _FOUND, "discovering")
    )
    on_progress(_FOUND, "reporting")
    model = build_next_model(found, parent)
    asked = design_discrimination(found)
    content = discovery_json(found) | {
        "model": {k: model.content[k] for k in ("version", "parent", "difference")},
        "verdict": model.content["verdict"],
        "ask": None if asked is None else proposal_json(asked, ASK),
    }
    return Discovered(found, content, model, asked)
