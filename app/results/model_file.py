"""`model.json`: the model with what was found, its version, and what became of it.

It is read as a result is: what predicts, exports or compares from a result does so from
a model, with the effects that were found in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

import numpy as np

from app.discovery.discover import Discovery
from app.discovery.extended_model import (
    ExtendedModel,
    baseline_model,
    extend_model,
)
from app.discovery.findings import Finding
from app.estimation.baseline import ReferenceModel
from app.estimation.extrapolation import find_measured_ranges
from app.estimation.observability import assess_observability
from app.estimation.prior_model import PriorModel
from app.files.machine_file import machine_to_json
from app.files.model_file import EstimatedModel, model_to_json
from app.files.result_file import MODEL_SCHEMA
from app.files.run import Run
from app.files.run_summary import digest_run
from app.files.units import unit_of
from app.kinematics.effects.target_placement import find_tool_orientation
from app.kinematics.model import MachineModel
from app.results.direction_tables import compute_half_differences
from app.results.discovery_json import effect_json
from app.results.error_tables import error_tables
from app.results.model_difference import list_differences
from app.results.result_json import (
    half_differences_json,
    locations_json,
    ranges_json,
    table_json,
)

_TURN_RAD = 1e-3  # how a tool may sit in the spindle


def given_by(earlier: PriorModel, run: Run) -> ReferenceModel:
    """Return an earlier model as the base that explains a Run.

    Raises BundleError if it is of another machine or of another target.
    """
    earlier.require_same(run.machine)
    loaded = earlier.result
    model = MachineModel(run.machine, loaded.model.effects)
    offsets = np.array([t.offset_mm for t in run.machine.targets], float)
    model = model.with_effects(*find_tool_orientation(run.machine, offsets))
    size = loaded.model.size
    theta = np.zeros(model.size)
    theta[:size] = loaded.theta
    covariance = np.eye(model.size) * _TURN_RAD**2
    covariance[:size, :size] = loaded.covariance
    return ReferenceModel(model, theta, covariance)


@dataclass(frozen=True)
class NextModel:
    """What became of a model: its content as a file, and the change in words."""

    extended: ExtendedModel
    content: dict[str, Any]


def next_model(found: Discovery, parent: PriorModel | None) -> NextModel:
    """Return the model with what was found in it.

    parent : what the Run was held against; None for the rigid-body model fitted to it
    """
    grown = extend_model(found)
    state = EstimatedModel(grown.model, grown.theta, grown.covariance)
    before, told = _before(found, parent)
    return NextModel(
        grown,
        {
            "schema": MODEL_SCHEMA,
            "version": told["version"] + 1,
            "parent": told,
            "difference": [
                {"kind": c.kind, "what": c.what, "text": c.text}
                for c in list_differences(before, state)
            ],
            "machine": machine_to_json(grown.model.machine),
            "mode": found.aligned[0].run.mode,
            "effects": [_effect_json(f, grown) for f in found.findings],
            **_tables_json(grown, found),
            "observability": _observability_json(found),
            "provenance": {
                "software": "truepath",
                "software_version": version("truepath"),
                "created": datetime.now(UTC).isoformat(timespec="seconds"),
                "run": found.run_names,
                "input_sha256": digest_run(found.aligned[0].run),
                "runs": [*_earlier_runs(parent), *_runs_json(found)],
            },
            "model": model_to_json(grown.model, grown.theta, grown.covariance),
        },
    )


def _before(
    found: Discovery, parent: PriorModel | None
) -> tuple[EstimatedModel, dict[str, Any]]:
    if parent is None:
        base = baseline_model(found)
        told = {
            "version": 1,
            "source": "rigid-body model fitted to " + found.run_names,
            "sha256": None,
        }
        return EstimatedModel(base.model, base.theta, base.covariance), told
    told = {
        "version": parent.version,
        "source": parent.source,
        "sha256": parent.sha256,
    }
    return parent.result.estimated_model, told


def _runs_json(found: Discovery) -> list[dict[str, str]]:
    runs = [aligned.run for aligned in found.aligned]
    return [{"name": run.name, "input_sha256": digest_run(run)} for run in runs]


def _earlier_runs(parent: PriorModel | None) -> Sequence[dict[str, Any]]:
    """Return the Runs that what is known of the machine came from before."""
    return () if parent is None else parent.runs


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


def _tables_json(grown: ExtendedModel, found: Discovery) -> dict[str, Any]:
    ranges = find_measured_ranges(*(one.observations for one in found.aligned))
    tables = error_tables(grown.model, grown.theta, grown.covariance, ranges)
    halves = compute_half_differences(grown.model, grown.theta, grown.covariance)
    return {
        "error_tables": {t.symbol: table_json(t) for t in tables.tables},
        "squareness_urad": {
            s.symbol: {"value": s.value, "uncertainty": s.uncertainty}
            for s in tables.squareness
        },
        **locations_json(tables),
        "direction": {
            "model": "constant" if halves else "none",
            "half_difference": half_differences_json(halves),
        },
        "measured_range": ranges_json(ranges, grown.model.machine),
    }


def _observability_json(found: Discovery) -> dict[str, Any]:
    seen = assess_observability(found.baseline.model.machine, found.baseline.runs)
    return {
        "rank": seen.rank,
        "parameters": seen.parameters,
        "unobservable": list(seen.unobservable),
        "weak": list(seen.poorly_observable),
    }
