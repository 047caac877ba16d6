"""The content of `result.json` (schema `result/1` of the file formats).

`error_tables` holds known error motions only: one that the measured targets do not
determine is named in `observability.unobservable`. `model` has the parameters for
prediction, so that the file alone gives the map of the estimate.
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from typing import Any

import numpy as np
from jaxtyping import Float64

from truepath.alignment.stream.left_out import LeftOut
from truepath.estimation.solve.budget import SOURCES, UncertaintyBudget
from truepath.files.bundle.machine_file import machine_to_json
from truepath.files.bundle.run import RunSummary, combine_digests
from truepath.files.earlier.model_file import model_to_json
from truepath.files.earlier.result_file import RESULT_SCHEMA
from truepath.files.earlier.verdict import verdict_json
from truepath.files.environment import (
    INSTRUMENT,
    MEASURED,
    NOBODY,
    SERVICE,
    Refraction,
    find_cause,
    range_scale_uncertainty_ppm,
    refraction_to_json,
)
from truepath.files.units import PER_PPM, UM_PER_MM, URAD_PER_RAD
from truepath.results.error_tables import (
    compute_half_differences,
    observability_json,
    tables_json,
)
from truepath.results.grade_json import grade_json
from truepath.results.monte_carlo_results import trials_json
from truepath.results.result_summary import Findings, Provenance, RunFindings
from truepath.results.updated_effects import (
    describe_use,
    list_updated_effects,
    prior_model_json,
    state_updated_effects,
)

_BEAM_FRAME = "beam", "azimuth", "elevation"
_BUDGET_ON = (
    "root mean square of the volumetric error over the travel, without the rigid "
    "motion of the whole volume, k = 1; squares add up to that of the total"
)
_CORRECTED = (INSTRUMENT, SERVICE)


def result_json(found: Findings) -> dict[str, Any]:
    """The whole content of `result.json`."""
    estimate, machine = found.estimate, found.estimate.model.machine
    halves = compute_half_differences(estimate)
    return {
        "schema": RESULT_SCHEMA,
        "machine": machine_to_json(machine),
        "mode": found.main.summary.mode,
        "verdict": verdict_json(found.verdict),
        "left_out": [
            _encode_excluded(number, each)
            for number, own in enumerate(found.left_out)
            for each in own
        ],
        "setup_steps": [
            {
                "run": knock.run,
                "row": knock.row,
                "kind": knock.kind,
                "t_s": knock.time_s,
                "shift_um": UM_PER_MM * knock.moved_mm,
                "turn_urad": URAD_PER_RAD * knock.turned_rad,
            }
            for knock in found.setup_shifts
        ],
        **tables_json(
            found.tables, halves, estimate.direction, estimate.measured, machine
        ),
        "effects": state_updated_effects(
            list_updated_effects(estimate.known, estimate, estimate.chances),
            repeats_model=found.provenance.repeats_model,
        ),
        "monte_carlo": None if found.trials is None else trials_json(found.trials),
        "holds_for": {
            "any_tool": found.tables.any_tool,
            "targets": [
                {"name": t.name, "on": t.on, "offset_mm": list(t.offset_mm)}
                for t in found.tables.targets
            ],
        },
        "volumetric_error": _volumetric_json(found),
        "volumetric_uncertainty_um": found.contributions
        and UM_PER_MM * found.contributions.sigma_mm,
        "uncertainty_budget": found.budget and _budget_json(found.budget),
        "alignment": _alignment_json(found, found.main),
        "residuals": _residuals_json(
            np.concatenate([r.estimate.residuals.residual_mm for r in found.runs]),
            estimate.rms_mm,
            estimate.floor_mm,
            [{"run": r.number, **line} for r in found.runs for line in _lines_json(r)],
        ),
        "noise": {
            **_noise_json(found.main),
            "prior_strength": estimate.prior_precision,
        },
        "runs": [_run_json(found, run) for run in found.runs],
        "observability": observability_json(estimate.observability),
        "grade": None if found.grade is None else grade_json(found.grade),
        "provenance": _provenance_json(found),
        "model": model_to_json(estimate),
    }


def _volumetric_json(found: Findings) -> dict[str, Any]:
    both = found.both_directions
    return {
        "before": asdict(found.volumetric.before),
        "after_expected": asdict(found.volumetric.after),
        "both_directions": both and asdict(both.before),
        "left_in_both_directions": both and asdict(both.left),
        "on": f"a grid of {len(found.volumetric.position_mm)} points over the travel, "
        "without the rigid motion of the whole volume",
    }


def _residuals_json(
    residual_mm: Float64[np.ndarray, "n 3"],
    rms_mm: float,
    floor_mm: float,
    by_line: list[dict[str, Any]],
) -> dict[str, Any]:
    beam = UM_PER_MM * np.sqrt(np.mean(residual_mm**2, axis=0))
    return {
        "rms_um": UM_PER_MM * rms_mm,
        "noise_floor_um": UM_PER_MM * floor_mm,
        "by_direction_um": dict(zip(_BEAM_FRAME, beam.tolist(), strict=True)),
        "by_line": by_line,
    }


def _runs_behind(provenance: Provenance) -> list[dict[str, Any]]:
    model = () if provenance.model is None else provenance.model.runs
    own = [
        {"name": r.name, "input_sha256": r.digest, "sketch": r.sketch}
        for r in provenance.runs
    ]
    digests = {run["input_sha256"] for run in own}
    return [*(run for run in model if run["input_sha256"] not in digests), *own]


def _provenance_json(found: Findings) -> dict[str, Any]:
    provenance, run = found.provenance, found.main.summary
    known = found.known_scale
    return {
        "software": "truepath",
        "software_version": provenance.software_version,
        "created": provenance.created.isoformat(timespec="seconds"),
        "run": ", ".join(account.name for account in provenance.runs),
        "input_sha256": combine_digests(provenance.runs),
        "runs": _runs_behind(provenance),
        "source": run.source,
        **_control_json(provenance),
        "options": {"perpendicular_only": found.estimate.perpendicular_only},
        "model": provenance.model
        and {
            **prior_model_json(provenance.model),
            "taken": describe_use(
                provenance.model, repeats_model=provenance.repeats_model
            ),
        },
        "measured_s": run.measured_s,
        "length_scale_ppm": found.length_scale_ppm,
        "length_scale_in_tables": True,
        "known_lengths": known
        and {
            "count": known.lengths,
            "off_ppm": known.off / PER_PPM,
            "uncertainty_ppm": known.sigma / PER_PPM,
        },
        "feed_mm_min": list(run.feed_mm_min) if run.feed_mm_min else None,
        "temperature_degC": {k: list(v) for k, v in run.temperature_degc.items()},
    }


def _control_json(provenance: Provenance) -> dict[str, Any]:
    keys = ("control_compensation", "active_tables")
    told = {tuple(run.source.get(key) for key in keys) for run in provenance.runs}
    if len(told) > 1:
        return {"control_compensation": "mixed", "active_tables": None}
    ((state, tables),) = told
    return {
        "control_compensation": state,
        "active_tables": None if tables is None else json.loads(str(tables)),
    }


def _encode_excluded(run: int, each: LeftOut) -> dict[str, Any]:
    measured = each.samples > 0
    return {
        "run": run,
        "cause": each.cause,
        "row": each.row if each.row >= 0 else None,
        "from_s": each.begin_s if measured else None,
        "to_s": each.end_s if measured else None,
        "samples": each.samples,
        "distance_um": UM_PER_MM * each.off_mm if measured else None,
    }


def _run_json(found: Findings, run: RunFindings) -> dict[str, Any]:
    summary, residuals = run.summary, run.estimate.residuals
    return {
        "name": summary.name,
        "part": run.part or None,
        "mode": summary.mode,
        "samples": run.estimate.offered_samples,
        "used_samples": run.estimate.used_samples,
        "measured_s": summary.measured_s,
        "feed_mm_min": list(summary.feed_mm_min) if summary.feed_mm_min else None,
        "input_sha256": summary.digest,
        "source": summary.source,
        "tracker_told": list(summary.told),
        "commanded": {
            "sha256": summary.commanded.digest,
            "rows": summary.commanded.rows,
            "shown_mm": [list(at) for at in summary.commanded.shown_mm],
        },
        "environment": environment_json(summary),
        "interruptions": {
            **asdict(summary.interruptions),
            "driven_again": list(summary.driven_again),
        },
        "sample_quality": asdict(summary.quality) if summary.quality else None,
        "tracker_mm": run.estimate.pose.invert().translation_mm.round(3).tolist(),
        "without_it_um": found.get_uncertainty_without_run_um(run),
        "alignment": _alignment_json(found, run),
        "residuals": {
            **_residuals_json(
                residuals.residual_mm,
                residuals.rms_mm,
                residuals.floor_mm,
                _lines_json(run),
            ),
            "along_lines": _along_lines_json(found, run),
        },
        "noise": _noise_json(run),
        "seats": [
            {
                "target": seat.target.name,
                "on": seat.target.on,
                "shift_um": (UM_PER_MM * seat.shift_mm).tolist(),
                "uncertainty_um": (UM_PER_MM * seat.sigma_mm).tolist(),
            }
            for seat in run.estimate.seats
        ],
    }


def _alignment_json(found: Findings, run: RunFindings) -> dict[str, Any]:
    summary, estimate = run.summary, run.estimate
    sigma = np.sqrt(np.maximum(np.diag(estimate.pose_covariance), 0.0))
    first = 1 if summary.mode == "otf" else 0
    rows = set(range(first, first + summary.lines))
    parts = [each for each in found.runs if each.summary is summary]
    seen = {row for each in parts for row in each.estimate.measured_rows}
    return {
        "pose": {
            "from": "workpiece",
            "to": "tracker",
            "rotation": estimate.pose.rotation.tolist(),
            "shift_mm": estimate.pose.translation_mm.tolist(),
        },
        "pose_uncertainty": {
            "about_mm": estimate.centre_mm.tolist(),
            "shift_um": (UM_PER_MM * sigma[:3]).tolist(),
            "turn_urad": (URAD_PER_RAD * sigma[3:]).tolist(),
        },
        "lines": summary.lines,
        "matched_lines": estimate.lines,
        "rows_without_data": sorted(rows - seen),
        "cells": estimate.cells,
        "samples": estimate.offered_samples,
        "used_samples": estimate.used_samples,
    }


def _lines_json(run: RunFindings) -> list[dict[str, Any]]:
    lines = run.by_line
    return [
        {"row": int(row), "cells": int(cells), "rms_um": float(rms)}
        for row, cells, rms in zip(lines.row, lines.cells, lines.rms_um, strict=True)
    ]


def _along_lines_json(found: Findings, run: RunFindings) -> list[dict[str, Any]]:
    """Residual of every cell by line, over the distance from the line's first."""
    residuals, machine = run.estimate.residuals, found.estimate.model.machine
    straight = [machine.axis_names.index(axis.name) for axis in machine.linear_axes]
    place_mm = residuals.position_mm[:, straight]
    lines: list[dict[str, Any]] = []
    for row in np.unique(residuals.row):
        own = np.flatnonzero(residuals.row == row)
        along_mm = np.linalg.norm(place_mm[own] - place_mm[own[0]], axis=1)
        parts_um = UM_PER_MM * residuals.residual_mm[own].T
        lines.append(
            {
                "row": int(row),
                "along_mm": along_mm.round(2).tolist(),
                **{
                    f"{name}_um": part.round(3).tolist()
                    for name, part in zip(_BEAM_FRAME, parts_um, strict=True)
                },
            }
        )
    return lines


def _noise_json(run: RunFindings) -> dict[str, Any]:
    noise, known = run.noise, ("along_beam", "across_beam")
    return {
        "distance_mm": noise.distance_mm,
        "stated_um": dict(zip(known, noise.stated_um.tolist(), strict=True)),
        "white_um": dict(zip(known, noise.white_um.tolist(), strict=True)),
        "slow_um": dict(zip(known, noise.ou_um.tolist(), strict=True)),
        "slow_time_s": noise.ou_time_s,
        "between_places_um": dict(zip(_BEAM_FRAME, run.estimate.place_um, strict=True)),
        "along_travel_um": noise.along_travel_um,
    }


def _budget_json(budget: UncertaintyBudget) -> dict[str, Any]:
    variance = budget.variance_mm2
    return {
        "sources_um": {
            source: _state_um(row)
            for source, row in zip(SOURCES, variance, strict=True)
        },
        "total_um": _state_um(variance.sum(axis=0)),
        "on": _BUDGET_ON,
    }


def _state_um(variance_mm2: Float64[np.ndarray, "3"]) -> dict[str, float]:
    # The remainder of a difference may be below 0 by rounding.
    every = np.maximum([*variance_mm2, variance_mm2.sum()], 0.0)
    return dict(
        zip(
            ("x", "y", "z", "volume"),
            (UM_PER_MM * np.sqrt(every)).tolist(),
            strict=True,
        )
    )


def environment_json(summary: RunSummary) -> dict[str, Any]:
    """Sensors and their faults, refraction and the scale that it leaves uncertain."""
    refraction = summary.refraction
    ppm, per_k, per_hpa = range_scale_uncertainty_ppm(refraction)
    is_corrected = refraction.by in _CORRECTED
    return {
        "sensors": [
            {
                "name": one.name,
                "mean": _or_none(one.mean),
                "low": _or_none(one.low),
                "high": _or_none(one.high),
                "change": _or_none(one.change),
                "readings": one.readings,
                "rows": one.rows,
                "longest_without_s": one.hole_s,
                "used": one.is_used,
            }
            for one in summary.sensors
        ],
        "told": list(summary.sensors_told),
        "refraction": refraction_to_json(refraction),
        "range_scale": {
            "uncertainty_ppm": ppm if is_corrected else None,
            "per_K_ppm": per_k,
            "per_hPa_ppm": per_hpa,
            "in_tables": True,
        },
    }


def describe_refraction(refraction: Refraction) -> str:
    """Which party corrected the ranges for the air; completes a sentence."""
    if refraction.by == INSTRUMENT:
        return "corrected by the instrument itself"
    if refraction.by == SERVICE and refraction.index is not None:
        light = refraction.light
        kind = "group " if light is not None and light.is_group else ""
        wave = "" if light is None else f" at {light.wavelength_nm:g} nm"
        ppm = 1e6 * (refraction.index - 1.0)
        told = f"corrected here, once: mean {kind}index 1 + {ppm:.2f}·10⁻⁶{wave}"
        return f"{told}, of usual air: {refraction.why}" if refraction.why else told
    if refraction.by == NOBODY:
        return f"NOT corrected: {find_cause(refraction)[1]}"
    return "not corrected here; whether the instrument does is not known"


def describe_scale(refraction: Refraction) -> str:
    """Uncertainty by the air of the scale of all ranges; completes a sentence."""
    ppm, per_k, per_hpa = range_scale_uncertainty_ppm(refraction)
    what = f"{per_k:.2f} ppm a K and {per_hpa:.2f} ppm a hPa that the air is mistaken"
    common = (
        "common to all ranges, and to the positioning errors of all axes alike; the "
        "uncertainties of the tables contain it"
    )
    if refraction.by not in _CORRECTED:
        return f"{what}, {common}"
    if refraction.why:
        return f"{ppm:.1f} ppm (k = 1) of usual air: {what}, {common}"
    at = f"{MEASURED['air_degC']:g} K and {MEASURED['pressure_hPa']:g} hPa"
    return f"{ppm:.1f} ppm (k = 1) where the air is known to {at}: {what}, {common}"


def _or_none(value: float) -> float | None:
    return None if math.isnan(value) else value
