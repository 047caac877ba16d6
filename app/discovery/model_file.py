"""`model.json`: the model with what was found, its version, and what became of it.

It is read as a result is: what predicts, exports or compares from a result does so from
a model, with the effects that were found in it.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

import numpy as np

from app.alignment.observations import Observations
from app.discovery.base import GivenModel
from app.discovery.discover import Discovery, Finding
from app.discovery.discovery_json import effect_json
from app.discovery.extending import Extended, extended, plain
from app.errors import BundleError
from app.estimation.extrapolation import measured_ranges
from app.estimation.observability import observability
from app.estimation.runs import Measured
from app.kinematics.effects.tool_orientation import tool_orientation
from app.kinematics.machine import Machine
from app.kinematics.model import MachineModel
from app.measurement.machine_file import machine_to_json
from app.measurement.run import Run
from app.reporting.catalogued_json import unit_of
from app.reporting.direction_tables import half_differences
from app.reporting.error_tables import error_tables
from app.reporting.model_difference import ModelState, difference
from app.reporting.model_json import model_to_json
from app.reporting.result_json import (
    MODEL_SCHEMA,
    LoadedResult,
    halves_json,
    locations_json,
    ranges_json,
    table_json,
)
from app.reporting.run_account import run_digest

_TURN_RAD = 1e-3  # how a tool may sit in the spindle


@dataclass(frozen=True)
class Parent:
    """The model that a Run was held against.

    source : its file, or its identifier in the service; sha256 : of the file
    """

    loaded: LoadedResult
    source: str
    sha256: str

    def given(self, run: Run) -> GivenModel:
        """Return it as the base that explains a Run.

        Raises BundleError if it is of another machine or of another target.
        """
        self._require_same(run.machine)
        model = MachineModel(run.machine, self.loaded.model.effects)
        offsets = np.array([t.offset_mm for t in run.machine.targets], float)
        tool = tool_orientation(run.machine, offsets)
        model = model.with_effects(*tool)
        size = self.loaded.model.size
        theta = np.zeros(model.size)
        theta[:size] = self.loaded.theta
        covariance = np.eye(model.size) * _TURN_RAD**2
        covariance[:size, :size] = self.loaded.covariance
        return GivenModel(model, theta, covariance)

    def _require_same(self, machine: Machine) -> None:
        own = self.loaded.machine
        for field, mine, theirs in (
            ("kinematic_chain", own.chain, machine.chain),
            ("axes", _travels(own), _travels(machine)),
        ):
            if mine != theirs:
                raise BundleError(
                    f"machine.{field}: {mine}, but {theirs} in the measurement",
                    file=self.source,
                    remedy="give a model of the measured machine",
                )
        same = {(t.on, t.offset_mm) for t in machine.targets} <= {
            (t.on, t.offset_mm) for t in own.targets
        }
        if not same and not self.loaded.tables().any_tool:
            raise BundleError(
                "holds for its own target offset alone: it does not have all motions",
                file=self.source,
                remedy="give a model made with the measured target, or with several",
            )


def _travels(machine: Machine) -> str:
    return ", ".join(f"{a.name} {a.low:g} to {a.high:g}" for a in machine.axes)


@dataclass(frozen=True)
class NextModel:
    """What became of a model: its content as a file, and the change in words."""

    extended: Extended
    content: dict[str, Any]


def next_model(found: Discovery, parent: Parent | None) -> NextModel:
    """Return the model with what was found in it.

    parent : what the Run was held against; None for the rigid-body model fitted to it
    """
    grown = extended(found)
    state = ModelState(grown.model, grown.theta, grown.covariance)
    before, told = _before(found, parent)
    return NextModel(
        grown,
        {
            "schema": MODEL_SCHEMA,
            "version": told["version"] + 1,
            "parent": told,
            "difference": [
                {"kind": c.kind, "what": c.what, "text": c.text}
                for c in difference(before, state)
            ],
            "machine": machine_to_json(grown.model.machine),
            "mode": found.scene.run.mode,
            "effects": [_effect_json(f, grown) for f in found.findings],
            **_tables_json(grown, found),
            "observability": _observability_json(found.ground.coarse, found),
            "provenance": {
                "software": "truepath",
                "software_version": version("truepath"),
                "created": datetime.now(UTC).isoformat(timespec="seconds"),
                "run": found.scene.run.name,
                "input_sha256": run_digest(found.scene.run),
            },
            "model": model_to_json(grown.model, grown.theta, grown.covariance),
        },
    )


def _before(
    found: Discovery, parent: Parent | None
) -> tuple[ModelState, dict[str, Any]]:
    if parent is None:
        base = plain(found)
        told = {
            "version": 1,
            "source": f"rigid-body model fitted to {found.scene.run.name}",
            "sha256": None,
        }
        return ModelState(base.model, base.theta, base.covariance), told
    loaded = parent.loaded
    told = {
        "version": loaded.version,
        "source": parent.source,
        "sha256": parent.sha256,
    }
    return ModelState(loaded.model, loaded.theta, loaded.covariance), told


def _effect_json(finding: Finding, grown: Extended) -> dict[str, Any]:
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


def _tables_json(grown: Extended, found: Discovery) -> dict[str, Any]:
    ranges = measured_ranges(found.scene.seen)
    tables = error_tables(grown.model, grown.theta, grown.covariance, ranges)
    halves = half_differences(grown.model, grown.theta, grown.covariance)
    return {
        "error_tables": {t.symbol: table_json(t) for t in tables.tables},
        "squareness_urad": {
            s.symbol: {"value": s.value_urad, "uncertainty": s.uncertainty_urad}
            for s in tables.squareness
        },
        **locations_json(tables),
        "direction": {
            "model": "constant" if halves else "none",
            "half_difference": halves_json(halves),
        },
        "measured_range": ranges_json(ranges, grown.model.machine),
    }


def _observability_json(coarse: Observations, found: Discovery) -> dict[str, Any]:
    base = found.ground.base
    seen = observability(coarse.at.machine, [Measured(coarse, base.pose, base.noise)])
    return {
        "rank": seen.rank,
        "parameters": seen.parameters,
        "unobservable": list(seen.unobservable),
        "weak": list(seen.weak),
    }
