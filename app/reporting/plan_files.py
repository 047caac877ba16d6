"""The files of a plan: commanded rows, NC programs, `plan.json`, and a page."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path as FilePath
from typing import Any

from app.estimation.prior_model import PriorModel
from app.files.commanded_file import encode_commanded
from app.files.machine_file import machine_to_json
from app.files.whole_files import replace_file
from app.kinematics.symbols import SQUARENESS, find_unit, is_location
from app.motion.nc_programs.programs import (
    list_dialects,
    name_file,
    write_program,
)
from app.planning.plan import Plan
from app.reporting.plan_report import render_plan_report
from app.results.updated_effects import predicted_effects_json
from drivers.interfaces.records import Path

SCHEMA = "plan/1"
_PER_UNIT = {"um": 1e3, "urad": 1e6}


def plan_document(planned: Plan) -> dict[str, Any]:
    """Return the content of `plan.json`: µm, µrad and s, k = 1 where unsaid."""
    request, found = planned.request, planned.forecast
    target_um = request.target_um
    return {
        "schema": SCHEMA,
        "machine": machine_to_json(planned.machine),
        "mode": request.mode,
        "rows": len(planned.commanded),
        "duration_s": round(planned.duration_s, 3),
        "corner_path": request.corner_path,
        "perpendicular_only": request.perpendicular_only,
        "feeds_mm_min": list(request.feeds_mm_min),
        "model": None if request.model is None else _model_json(request.model),
        "tracker": {
            "position_mm": [round(float(v), 3) for v in planned.station_mm],
            "assumed": request.workspace.tracker_mm is None,
        },
        "predicted": {
            **_both(planned.uncertainty_um),
            "errors": _errors(planned),
            "effects": predicted_effects_json(
                found.known, found.model, found.covariance
            ),
            "servo_mismatch": {
                axis: {"uncertainty_ms": 1e3 * sigma}
                for axis, sigma in planned.lag_sigma_s.items()
            },
        },
        "target": None
        if target_um is None
        else {**_both(target_um), "reached": planned.reached},
        "curve": [
            {
                "row": row + 1,
                "time_s": round(float(planned.time_s[row]), 3),
                **_both(1e3 * sigma),
            }
            for row, sigma in zip(found.row, found.sigma_mm, strict=True)
        ],
        "unobservable": list(unobservable(planned)),
    }


def _model_json(model: PriorModel) -> dict[str, Any]:
    return {
        "source": model.source,
        "version": model.version,
        "sha256": model.sha256,
    }


def unobservable(planned: Plan) -> tuple[str, ...]:
    """Return what the plan cannot tell, in words."""
    said = planned.forecast.unobservable
    turning = [axis.name for axis in planned.machine.rotary_axes]
    if planned.request.mode == "otf" and turning:
        axes = ", ".join(turning)
        said += (
            f"{axes}: rotary axes stand still on this path; their errors show between "
            "standstills (--mode standstill)",
        )
    return said


def write_plan(
    planned: Plan, folder: FilePath, controls: Sequence[str] = ()
) -> dict[str, Any]:
    """Write the files of a plan and return the content of `plan.json`.

    controls : whose NC programs are written; of all where left out

    Raises BadInput, nothing written, if a control cannot drive the plan.
    """
    commanded, machine = planned.commanded, planned.machine
    rows = "path.csv" if isinstance(commanded, Path) else "points.csv"
    files = {rows: encode_commanded(commanded, machine)}
    feed = planned.request.feeds_mm_min[0]
    for control in controls or list_dialects():
        text = write_program(commanded, machine, control, feed_mm_min=feed)
        files[f"{control}/{name_file(text, control)}"] = text.encode()
    document = plan_document(planned) | {"files": [*files, "plan.json", "plan.html"]}
    files["plan.json"] = (json.dumps(document, indent=1) + "\n").encode()
    files["plan.html"] = render_plan_report(document).encode()
    for name, data in files.items():
        file = folder / name
        file.parent.mkdir(parents=True, exist_ok=True)
        replace_file(file, data)
    return document


def _both(standard_um: float) -> dict[str, float]:
    """Return a volumetric uncertainty as files state it: k = 1, and k = 2."""
    return {
        "volumetric_uncertainty_um": standard_um,
        "expanded_volumetric_uncertainty_um": 2.0 * standard_um,
    }


def _errors(planned: Plan) -> dict[str, dict[str, float]]:
    found: dict[str, dict[str, float]] = {}
    for symbol, sigma in planned.forecast.motion_sigmas().items():
        single = symbol in SQUARENESS or is_location(symbol)
        kind = find_unit(symbol) if single or symbol.startswith("E") else "um"
        found[symbol] = {f"uncertainty_{kind}": sigma * _PER_UNIT[kind]}
    return found
