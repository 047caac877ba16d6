"""`result.json` (schema `result/1` of the file formats), written and read.

`error_tables` holds what is known and nothing else: an error motion that the measured
targets cannot tell is named in `observability.unobservable`. `model` carries what
prediction needs, so that the file alone gives the map of the estimate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float64

from app.errors import BundleError
from app.estimation.extrapolation import Ranges
from app.files.json_fields import Field, Fields
from app.files.machine_file import machine_from_json, machine_to_json
from app.kinematics.machine import Machine, position_unit
from app.kinematics.model import MachineModel
from app.results.direction_tables import HalfDifference, half_differences
from app.results.effects_beside import (
    account_json,
    effects_beside,
    effects_json,
)
from app.results.error_tables import (
    MILLI,
    ErrorTable,
    ErrorTables,
    error_tables,
)
from app.results.findings import Findings, Provenance
from app.results.grade_json import grade_json
from app.results.model_json import model_from_json, model_to_json
from app.results.run_account import digest_of_all
from app.results.run_json import (
    alignment_json,
    by_direction_json,
    lines_json,
    noise_json,
    run_json,
)
from app.results.trials_json import trials_json

SCHEMA, MODEL_SCHEMA = "result/1", "extended-model/1"
MODES = ("otf", "standstill")
_MANDATORY = (
    "machine",
    "mode",
    "error_tables",
    "squareness_urad",
    "alignment",
    "residuals",
    "observability",
    "provenance",
)
_MANDATORY_IN_MODEL = ("machine", "mode", "observability", "provenance", "model")


@dataclass(frozen=True, slots=True)
class LoadedResult:
    """What a result or model file says about the machine.

    unobservable : statements in words; provenance : as the file states it
    measured : by axis, the range beyond which tables are extrapolated, if it is known
    version : of the model; that of a result, which has no parent, is 1
    """

    machine: Machine
    mode: str
    model: MachineModel
    theta: Float64[np.ndarray, " p"]
    covariance: Float64[np.ndarray, "p p"]
    unobservable: tuple[str, ...]
    provenance: dict[str, Any]
    measured: Ranges = field(default_factory=dict[str, tuple[float, float]])
    version: int = 1

    def tables(self) -> ErrorTables:
        """Return the error tables."""
        return error_tables(self.model, self.theta, self.covariance, self.measured)


def result_json(found: Findings) -> dict[str, Any]:
    """Return the content of the result file."""
    estimate = found.estimate
    return {
        "schema": SCHEMA,
        "machine": machine_to_json(estimate.model.machine),
        "mode": found.main.account.mode,
        "error_tables": {t.symbol: table_json(t) for t in found.tables.tables},
        "squareness_urad": {
            s.symbol: {"value": s.value_urad, "uncertainty": s.uncertainty_urad}
            for s in found.tables.squareness
        },
        "direction": _direction_json(found),
        "effects": effects_json(effects_beside(estimate), found.provenance.model),
        "monte_carlo": None if found.trials is None else trials_json(found.trials),
        **locations_json(found.tables),
        "holds_for": _holds_for(found.tables),
        "volumetric_error": _volumetric_json(found),
        "alignment": alignment_json(found.main),
        "residuals": _residuals_json(found),
        "noise": {**noise_json(found.main), "prior_strength": estimate.prior_precision},
        "runs": [run_json(run) for run in found.runs],
        "observability": {
            "rank": estimate.observability.rank,
            "parameters": estimate.observability.parameters,
            "unobservable": list(estimate.observability.unobservable),
            "weak": list(estimate.observability.weak),
        },
        "measured_range": ranges_json(
            found.estimate.measured, found.estimate.model.machine
        ),
        "grade": None if found.grade is None else grade_json(found.grade),
        "provenance": _provenance_json(found),
        "model": model_to_json(estimate.model, estimate.theta, estimate.covariance),
    }


def read_result(content: object, *, file: str = "result.json") -> LoadedResult:
    """Return what the parsed JSON of a result file, or of a model file, says.

    Raises BundleError naming file and key if it is of another schema or incomplete.
    """
    top = Field(file, "", content).mapping()
    schema = top.child("schema")
    if schema.value not in (SCHEMA, MODEL_SCHEMA):
        raise schema.error(
            "is not that of a result or model",
            f"give a file of {SCHEMA} or {MODEL_SCHEMA}",
        )
    extended = schema.value == MODEL_SCHEMA
    for key in _MANDATORY_IN_MODEL if extended else _MANDATORY:
        top.child(key)
    machine = machine_from_json(top.child("machine").value, file=file, key="machine")
    if "model" not in top:
        raise BundleError(
            "model is missing, without which nothing can be predicted",
            file=file,
            remedy="analyse the bundle again",
        )
    saved = model_from_json(top.child("model"), machine)
    return LoadedResult(
        machine,
        top.child("mode").choice(MODES),
        saved.model,
        saved.theta,
        saved.covariance,
        _unobservable(top),
        dict(top.child("provenance").mapping().values),
        _measured(top, machine),
        _version(top.child("version")) if extended else 1,
    )


def _version(stated: Field) -> int:
    value = stated.number(lowest=1.0)
    if value != int(value):
        raise stated.error(f"is {value:g}", "write a whole number")
    return int(value)


def _unobservable(top: Fields) -> tuple[str, ...]:
    field = top.child("observability").mapping().child("unobservable")
    return tuple(element.text() for element in field.elements())


def _measured(top: Fields, machine: Machine) -> Ranges:
    if "measured_range" not in top:
        return {}
    stated = top.child("measured_range").mapping()
    return {
        axis.name: (
            (ends := stated.child(axis.name).mapping())
            .child(f"from_{position_unit(axis)}")
            .number(),
            ends.child(f"to_{position_unit(axis)}").number(),
        )
        for axis in machine.axes
        if axis.name in stated
    }


def table_json(table: ErrorTable) -> dict[str, Any]:
    """Return an error table."""
    return {
        f"position_{table.position_unit}": table.position_mm.tolist(),
        f"value_{table.unit}": table.value.tolist(),
        f"uncertainty_{table.unit}": table.uncertainty.tolist(),
        "extrapolated": table.extrapolated.tolist(),
    }


def ranges_json(ranges: Ranges, machine: Machine) -> dict[str, Any]:
    """Return the range of each axis beyond which its tables are extrapolated."""
    return {
        axis.name: {
            f"from_{position_unit(axis)}": ranges[axis.name][0],
            f"to_{position_unit(axis)}": ranges[axis.name][1],
        }
        for axis in machine.axes
        if axis.name in ranges
    }


def _direction_json(found: Findings) -> dict[str, Any]:
    estimate = found.estimate
    halves = half_differences(estimate.model, estimate.theta, estimate.covariance)
    plain = estimate.direction == "none" and halves  # lost motion of a model's
    return {
        "model": "constant" if plain else estimate.direction,
        "half_difference": halves_json(halves),
    }


def halves_json(halves: Sequence[HalfDifference]) -> dict[str, Any]:
    """Return half the difference of both directions, by symbol."""
    return {
        half.symbol: {
            "position_mm": half.position_mm.tolist(),
            f"value_{half.unit}": half.value.tolist(),
            f"uncertainty_{half.unit}": half.uncertainty.tolist(),
        }
        for half in halves
    }


def locations_json(tables: ErrorTables) -> dict[str, Any]:
    """Return where rotary axes are; nothing for a machine that has none."""
    if not tables.locations:
        return {}
    return {
        "axis_location": {
            place.symbol: {
                f"value_{place.unit}": place.value,
                f"uncertainty_{place.unit}": place.uncertainty,
            }
            for place in tables.locations
        }
    }


def _holds_for(tables: ErrorTables) -> dict[str, Any]:
    return {
        "any_tool": tables.any_tool,
        "targets": [
            {"name": t.name, "on": t.on, "offset_mm": list(t.offset_mm)}
            for t in tables.targets
        ],
    }


def _volumetric_json(found: Findings) -> dict[str, Any]:
    return {
        "before": asdict(found.volumetric.before),
        "after_expected": asdict(found.volumetric.after),
        "on": f"a grid of {len(found.volumetric.position_mm)} points over the travel, "
        "without the rigid motion of the whole volume",
    }


def _residuals_json(found: Findings) -> dict[str, Any]:
    """Return the residuals over the cells of all Runs."""
    every = np.concatenate([run.estimate.residuals.residual_mm for run in found.runs])
    return {
        "rms_um": MILLI * found.estimate.rms_mm,
        "noise_floor_um": MILLI * found.estimate.floor_mm,
        "by_direction_um": by_direction_json(every),
        "by_line": [
            {"run": run.number, **line}
            for run in found.runs
            for line in lines_json(run)
        ],
    }


def _runs_behind(provenance: Provenance) -> list[dict[str, Any]]:
    """Return the Runs that the numbers come from, those of the model among them."""
    model = () if provenance.model is None else provenance.model.runs
    own = [{"name": r.name, "input_sha256": r.digest} for r in provenance.runs]
    digests = {run["input_sha256"] for run in own}
    return [*(run for run in model if run["input_sha256"] not in digests), *own]


def _provenance_json(found: Findings) -> dict[str, Any]:
    provenance, run = found.provenance, found.main.account
    return {
        "software": "truepath",
        "software_version": provenance.software_version,
        "created": provenance.created.isoformat(timespec="seconds"),
        "run": ", ".join(account.name for account in provenance.runs),
        "input_sha256": digest_of_all(provenance.runs),
        "runs": _runs_behind(provenance),
        "source": run.source,
        "options": {"perpendicular_only": found.estimate.perpendicular_only},
        "model": account_json(provenance.model),
        "measured_s": run.measured_s,
        "feed_mm_min": list(run.feed_mm_min) if run.feed_mm_min else None,
        "temperature_degC": {k: list(v) for k, v in run.temperature_degc.items()},
    }
