"""The content of `result.json` (schema `result/1` of the file formats).

`error_tables` holds what is known and nothing else: an error motion that the measured
targets cannot tell is named in `observability.unobservable`. `model` carries what
prediction needs, so that the file alone gives the map of the estimate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from app.estimation.extrapolation import Ranges
from app.files.machine_file import machine_to_json
from app.files.model_file import model_to_json
from app.files.result_file import RESULT_SCHEMA
from app.files.run_summary import combine_digests
from app.files.units import UM_PER_MM
from app.kinematics.machine import Machine, position_unit
from app.results.direction_tables import HalfDifference, compute_half_differences
from app.results.error_tables import ErrorTable, ErrorTables
from app.results.findings import Findings, Provenance
from app.results.grade_json import grade_json
from app.results.run_json import (
    alignment_json,
    by_direction_json,
    lines_json,
    noise_json,
    run_json,
)
from app.results.trials_json import trials_json
from app.results.updated_effects import (
    list_updated_effects,
    updated_effects_json,
    used_model_json,
)


def result_json(found: Findings) -> dict[str, Any]:
    """Return the content of the result file."""
    estimate = found.estimate
    return {
        "schema": RESULT_SCHEMA,
        "machine": machine_to_json(estimate.model.machine),
        "mode": found.main.summary.mode,
        "error_tables": {t.symbol: table_json(t) for t in found.tables.tables},
        "squareness_urad": {
            s.symbol: {"value": s.value, "uncertainty": s.uncertainty}
            for s in found.tables.squareness
        },
        "direction": _direction_json(found),
        "effects": updated_effects_json(
            list_updated_effects(estimate), found.provenance.model
        ),
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
            "weak": list(estimate.observability.poorly_observable),
        },
        "measured_range": ranges_json(
            found.estimate.measured, found.estimate.model.machine
        ),
        "grade": None if found.grade is None else grade_json(found.grade),
        "provenance": _provenance_json(found),
        "model": model_to_json(estimate.model, estimate.theta, estimate.covariance),
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
    halves = compute_half_differences(
        estimate.model, estimate.theta, estimate.covariance
    )
    plain = estimate.direction == "none" and halves  # lost motion of a model's
    return {
        "model": "constant" if plain else estimate.direction,
        "half_difference": half_differences_json(halves),
    }


def half_differences_json(halves: Sequence[HalfDifference]) -> dict[str, Any]:
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
        "rms_um": UM_PER_MM * found.estimate.rms_mm,
        "noise_floor_um": UM_PER_MM * found.estimate.floor_mm,
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
    provenance, run = found.provenance, found.main.summary
    return {
        "software": "truepath",
        "software_version": provenance.software_version,
        "created": provenance.created.isoformat(timespec="seconds"),
        "run": ", ".join(account.name for account in provenance.runs),
        "input_sha256": combine_digests(provenance.runs),
        "runs": _runs_behind(provenance),
        "source": run.source,
        "options": {"perpendicular_only": found.estimate.perpendicular_only},
        "model": used_model_json(provenance.model),
        "measured_s": run.measured_s,
        "feed_mm_min": list(run.feed_mm_min) if run.feed_mm_min else None,
        "temperature_degC": {k: list(v) for k, v in run.temperature_degc.items()},
    }
