"""`model.json`: the model with the effects found, its version, and its parent.

It is read as a result is: whatever predicts, exports or compares from a result does so
from a model, with the effects that were found in it.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from truepath.answers.comparison.model_difference import list_differences
from truepath.answers.discovery.discovery_json import effect_json
from truepath.discovery.discover import (
    Discovery,
    ExtendedModel,
    baseline_model,
    extend_model,
)
from truepath.discovery.findings import Finding
from truepath.estimation.problem.observability import assess_observability
from truepath.estimation.problem.prior_model import PriorModel
from truepath.estimation.solve.extrapolation import find_measured_ranges
from truepath.files.bundle.machine_file import machine_to_json
from truepath.files.bundle.run import Run, digest_run
from truepath.files.earlier.model_file import model_to_json
from truepath.files.earlier.result_file import MODEL_SCHEMA
from truepath.files.earlier.verdict import Verdict, verdict_json
from truepath.files.units import unit_of
from truepath.kinematics.effects.pose_timing_seats import list_target_seats
from truepath.kinematics.model import EstimatedModel
from truepath.kinematics.volumetric_map import build_shape_model
from truepath.results.error_tables import (
    build_error_tables,
    compute_half_differences,
    observability_json,
    tables_json,
)
from truepath.results.result_assessment import assess_discovery


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
    machine = grown.model.machine
    before, origin = _describe_parent(found, parent)
    measured = find_measured_ranges(*(one.observations for one in found.aligned))
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
            "machine": machine_to_json(machine),
            "mode": found.aligned[0].run.mode,
            "verdict": verdict_json(verdict),
            "effects": [_effect_json(f, grown) for f in found.findings],
            **tables_json(
                build_error_tables(grown, measured),
                compute_half_differences(grown),
                "none",
                measured,
                machine,
            ),
            "observability": observability_json(
                assess_observability(shapes, baseline.runs)
            ),
            "provenance": _describe_origin(found, parent),
            "model": model_to_json(grown),
        },
    )


def _describe_origin(found: Discovery, parent: PriorModel | None) -> dict[str, Any]:
    runs = [
        {"name": one.run.name, "input_sha256": digest_run(one.run)}
        for one in found.aligned
    ]
    return {
        "software": "truepath",
        "software_version": version("truepath"),
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "run": found.run_names,
        "input_sha256": runs[0]["input_sha256"],
        "runs": [*(parent.runs if parent else ()), *runs],
    }


def _describe_parent(
    found: Discovery, parent: PriorModel | None
) -> tuple[EstimatedModel, dict[str, Any]]:
    if parent is None:
        before = baseline_model(found)
        version, source = 1, f"rigid-body model fitted to {found.run_names}"
        sha256 = None
    else:
        before = parent.result
        version, source, sha256 = parent.version, parent.source, parent.sha256
    return before, {"version": version, "source": source, "sha256": sha256}


def _effect_json(finding: Finding, grown: ExtendedModel) -> dict[str, Any]:
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
