"""From Runs to the effects that their model lacks, the extended model, the next lines.

`model.json` holds the model with the effects found, its version, and its parent. It is
read as a result is: whatever predicts, exports or compares from a result does so from a
model, with the effects that were found in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from truepath.answers.discovery_json import discovery_json, effect_json, proposal_json
from truepath.answers.model_difference import list_differences
from truepath.discovery.discover import (
    Discovery,
    ExtendedModel,
    baseline_model,
    discover,
    extend_model,
)
from truepath.discovery.discrimination import DiscriminationDesign
from truepath.discovery.findings import Finding
from truepath.discovery.open_questions import design_discrimination
from truepath.estimation.problem.observability import assess_observability
from truepath.estimation.problem.prior_model import PriorModel
from truepath.estimation.solve.extrapolation import compute_measured_ranges
from truepath.files.bundle.machine_file import machine_to_json
from truepath.files.bundle.run import Run, digest_run
from truepath.files.earlier.model_file import model_to_json
from truepath.files.earlier.result_file import MODEL_SCHEMA
from truepath.files.earlier.verdict import Verdict, verdict_json
from truepath.files.units import unit_of
from truepath.kinematics.effects.pose_timing_seats import list_target_seats
from truepath.kinematics.model import EstimatedModel
from truepath.kinematics.volumetric_map import build_shape_model
from truepath.progress import Progress, ignore_progress, scale_progress
from truepath.results.error_tables import (
    build_error_tables,
    compute_half_differences,
    observability_json,
    tables_json,
)
from truepath.results.result_assessment import assess_discovery

ASK = "ask/path.csv"
_FOUND = 0.95  # share of the work that is done with the search


def build_reference(earlier: PriorModel, run: Run) -> EstimatedModel:
    """An earlier model as the base that explains a Run.

    Raises BundleError if it is of another machine or of another target, NotUsable if it
    is not to be used.
    """
    earlier.require_comparable(run.machine)
    loaded = earlier.result
    model = replace(loaded.model, machine=run.machine)
    seats = list_target_seats([run.machine.targets])
    model = model.with_effects(*seats)
    size = loaded.model.size
    theta = np.zeros(model.size)
    theta[:size] = loaded.theta
    sigma = np.repeat([seat.target.seat_sigma_mm for seat in seats], 3)
    covariance = block_diag(loaded.covariance, np.diag(sigma**2))
    return EstimatedModel(model, theta, covariance)


@dataclass(frozen=True)
class NextModel:
    """A model with the effects found, its verdict, and its content as a file."""

    extended: ExtendedModel
    verdict: Verdict
    content: dict[str, Any]


def build_next_model(found: Discovery, parent: PriorModel | None) -> NextModel:
    """Version, parent, difference and content of the model with the effects found.

    parent : what the Run was compared with; None for the rigid-body model fitted to it
    """
    grown, verdict = extend_model(found), assess_discovery(found, parent)
    origin: dict[str, Any]
    if parent is None:
        before = baseline_model(found)
        source = f"rigid-body model fitted to {found.run_names}"
        origin = {"version": 1, "source": source, "sha256": None}
    else:
        before = parent.result
        origin = {
            "version": parent.version,
            "source": parent.source,
            "sha256": parent.sha256,
        }
    runs = [
        {"name": one.run.name, "input_sha256": digest_run(one.run)}
        for one in found.aligned
    ]
    measured = compute_measured_ranges(*(one.observations for one in found.aligned))
    baseline = found.baseline
    offsets_mm = [run.observations.at.offset_mm for run in baseline.runs]
    shapes = build_shape_model(baseline.model.machine, *offsets_mm)
    return NextModel(
        grown,
        verdict,
        {
            "schema": MODEL_SCHEMA,
            "version": origin["version"] + 1,
            "parent": origin,
            "difference": [asdict(c) for c in list_differences(before, grown)],
            "machine": machine_to_json(grown.model.machine),
            "mode": found.aligned[0].run.mode,
            "verdict": verdict_json(verdict),
            "effects": [_encode_effect(f, grown) for f in found.findings],
            **tables_json(
                build_error_tables(grown, measured),
                compute_half_differences(grown),
                "none",
                measured,
                grown.model.machine,
            ),
            "observability": observability_json(
                assess_observability(shapes, baseline.runs)
            ),
            "provenance": {
                "software": "truepath",
                "software_version": version("truepath"),
                "created": datetime.now(UTC).isoformat(timespec="seconds"),
                "run": found.run_names,
                "input_sha256": runs[0]["input_sha256"],
                "runs": [*(parent.runs if parent else ()), *runs],
            },
            "model": model_to_json(grown),
        },
    )


def _encode_effect(finding: Finding, grown: ExtendedModel) -> dict[str, Any]:
    effect = finding.candidate.effect
    scale = np.array([unit_of(p)[1] for p in effect.parameters])
    return {
        **effect_json(finding),
        "part_of": "machine" if grown.holds(finding) else "measurement",
        "linear": {
            "names": [p.name for p in effect.parameters],
            "units": [unit_of(p)[0] for p in effect.parameters],
            "values": (scale * finding.theta).tolist(),
            "covariance": (scale[:, None] * finding.covariance * scale).tolist(),
        },
    }


@dataclass(frozen=True, slots=True)
class Discovered:
    """Result of a discovery; content : of `discovery.json`.

    proposal : lines to measure next, written as `ASK`; None if no question is open
    """

    found: Discovery
    content: dict[str, Any]
    model: NextModel
    proposal: DiscriminationDesign | None


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
    proposal = design_discrimination(found)
    content = discovery_json(found) | {
        "model": {k: model.content[k] for k in ("version", "parent", "difference")},
        "verdict": model.content["verdict"],
        "ask": None if proposal is None else proposal_json(proposal, ASK),
    }
    return Discovered(found, content, model, proposal)
