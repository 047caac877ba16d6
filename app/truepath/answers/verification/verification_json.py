"""A verification as `verification.json` (schema `verification/1`)."""

from __future__ import annotations

from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

import numpy as np
from jaxtyping import Float64

from truepath.alignment.stream.left_out import LeftOut
from truepath.answers.verification.circles.circles_json import circles_json
from truepath.answers.verification.circles.static_circles import CircleFigures
from truepath.answers.verification.places.length_statistics import LengthStatistics
from truepath.answers.verification.places.matched_points import K, PointVectors
from truepath.answers.verification.places.multipoint_conformity import PointConformity
from truepath.answers.verification.static_test_figures import LineFigures
from truepath.answers.verification.verification import Verification, VerifiedRun
from truepath.answers.verification.verification_statements import state_findings
from truepath.files.earlier.verdict import verdict_json
from truepath.results.result_json import (
    environment_json,
)

SCHEMA = "verification/1"
_DIRECTIONS = "XYZ"


def verification_json(found: Verification) -> dict[str, Any]:
    """Content of `verification.json`, except `compensation` and `asked`.

    Uncertainties are standard ones (k = 1) where their key does not say `expanded`.
    """
    first = next(iter(found.runs))
    return {
        "schema": SCHEMA,
        "machine": found.result.machine.name,
        "compensated": found.is_compensated,
        "verdict": verdict_json(found.result.verdict),
        "run_verdict": verdict_json(found.run_verdict),
        "statements": list(state_findings(found)),
        "agreement": _agreement_json(found),
        "map_scale": _scale_json(found),
        "conformity": {
            name: _conformity_json(one, found) for name, one in found.conformity.items()
        },
        "volumetric_error_um": {
            name: _statistics_json(one) for name, one in found.statistics.items()
        },
        "difference_um": _difference_json(found),
        "directions": _directions_json(found.deviation),
        "worst": _worst_json(found),
        "lines": [_line_json(one) for one in found.driven.lines],
        "circles": [_circle_json(one) for one in found.driven.circles],
        **circles_json(found.circles),
        "places": _places_json(found),
        "components": "all three"
        if found.places.is_complete
        else "three at standstills, the two across the travel on lines",
        "unseen_directions": list(found.places.unseen_directions),
        "axes_at_rest": list(found.places.resting_axes),
        "gauge": "without the best-fit rigid motion over the measured places"
        f"{' of each Run' if len(found.runs) > 1 else ''}, each component counting "
        "the same",
        "noise": _noise_json(first),
        "run": _run_json(first),
        "runs": [{**_run_json(one), "noise": _noise_json(one)} for one in found.runs],
        "provenance": {
            "software": "truepath",
            "software_version": version("truepath"),
            "created": datetime.now(UTC).isoformat(timespec="seconds"),
            "result": dict(found.result.provenance),
        },
    }


def _agreement_json(found: Verification) -> dict[str, Any]:
    consistency = found.consistency
    return {
        "consistent": consistency.is_consistent,
        "chi_square": consistency.chi_square,
        "freedom": consistency.freedom,
        "noise_freedom": consistency.known_by,
        "chance": consistency.chance,
        "share_within_expanded": consistency.share_within,
        "chance_of_any_machine": consistency.repeated,
    }


def _scale_json(found: Verification) -> dict[str, Any] | None:
    if found.scale is None:
        return None
    return {
        "value": found.scale.value,
        "uncertainty": found.scale.uncertainty,
        "expected": found.scale.expected,
        "cause": found.scale.cause,
    }


def _run_json(run: VerifiedRun) -> dict[str, Any]:
    return {
        "name": run.summary.name,
        "mode": run.summary.mode,
        "input_sha256": run.summary.digest,
        "samples_used": run.samples[0],
        "samples_offered": run.samples[1],
        "left_out": [_describe_excluded(one) for one in run.left_out],
        "length_scale_ppm": run.scale_ppm,
        "environment": environment_json(run.summary),
    }


def _noise_json(run: VerifiedRun) -> dict[str, Any]:
    return {
        "white_of_stated": list(run.noise.white),
        "correlated_of_stated": list(run.noise.ou_along_and_across),
        "correlation_time_s": run.noise.ou_time_s,
    }


def _conformity_json(one: PointConformity, found: Verification) -> dict[str, Any]:
    return {
        "conformity": one.conformity.value,
        "rule": "ISO 14253-1",
        "tolerance_um": one.tolerance_um,
        "coverage_factor": one.coverage_factor,
        "length_um": one.length_um,
        "expanded_uncertainty_um": one.expanded_um,
        "row": int(found.places.row[one.worst]),
        "position": found.places.at.position_mm[one.worst].tolist(),
    }


def _statistics_json(one: LengthStatistics) -> dict[str, float]:
    content: dict[str, float] = {}
    for name, statistic in one.items():
        content[name] = statistic.value_um
        content[f"{name}_uncertainty"] = statistic.uncertainty_um
    return content


def _difference_json(found: Verification) -> dict[str, Any]:
    content: dict[str, Any] = {}
    measured, predicted = found.statistics["measured"], found.statistics["predicted"]
    for name, one in measured.items():
        other = predicted[name]
        expanded = K * float(np.hypot(one.uncertainty_um, other.uncertainty_um))
        difference = one.value_um - other.value_um
        content[name] = {
            "value": difference,
            "expanded_uncertainty": expanded,
            "within": abs(difference) <= expanded,
        }
    return content


def _directions_json(deviation: PointVectors) -> dict[str, Any]:
    value_um = 1e3 * deviation.vector_mm
    return {
        name: {
            "rms_um": float(np.sqrt(np.mean(value_um[:, k] ** 2))),
            "largest_um": float(np.abs(value_um[:, k]).max()),
            "uncertainty_um": float(np.sqrt(np.mean(deviation.sigma_um[:, k] ** 2))),
        }
        for k, name in enumerate(_DIRECTIONS)
    }


def _worst_json(found: Verification) -> dict[str, Any]:
    content: dict[str, Any] = {}
    for name, one in (("measured", found.measured), ("deviation", found.deviation)):
        worst = int(np.argmax(one.length_um))
        content[name] = {
            "row": int(found.places.row[worst]),
            "position": found.places.at.position_mm[worst].tolist(),
            "length_um": float(one.length_um[worst]),
            "expanded_uncertainty_um": K * float(one.length_sigma_um[worst]),
        }
    return content


def _places_json(found: Verification) -> dict[str, Any]:
    at, measured = found.places.at, found.conformity.get("measured")
    return {
        "row": found.places.row.tolist(),
        "run": found.places.run.tolist(),
        "position": at.position_mm.tolist(),
        "standstill": (at.line < 0).tolist(),
        "measured_um": _um_rows(found.measured.vector_mm),
        "measured_uncertainty_um": found.measured.sigma_um.tolist(),
        "predicted_um": _um_rows(found.predicted.vector_mm),
        "predicted_uncertainty_um": found.predicted.sigma_um.tolist(),
        "deviation_um": _um_rows(found.deviation.vector_mm),
        "conformity": [one.value for one in measured.each] if measured else None,
    }


def _describe_excluded(one: LeftOut) -> dict[str, Any]:
    return {
        "cause": one.cause,
        "row": one.row,
        "from_s": _or_none(one.begin_s),
        "to_s": _or_none(one.end_s),
        "samples": one.samples,
    }


def _or_none(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _um_rows(vector_mm: Float64[np.ndarray, "n 3"]) -> list[list[float]]:
    return (1e3 * vector_mm).tolist()


def _line_json(one: LineFigures) -> dict[str, Any]:
    return {
        "axes": one.axes,
        "standard": one.kind,
        "from": one.begin_mm.tolist(),
        "to": one.end_mm.tolist(),
        "runs": one.runs,
        "position_mm": one.position_mm.tolist(),
        "forward_um": one.forward_um.tolist(),
        "backward_um": one.backward_um.tolist(),
        "figures_um": one.figures_um,
        "uncertainty_um": one.uncertainty_um,
        "by_the_noise_alone_um": one.own_um,
        "predicted_um": one.predicted_um,
    }


def _circle_json(one: CircleFigures) -> dict[str, Any]:
    return {
        "plane": one.plane,
        "standard": "iso-230-4",
        "centre": one.centre_mm.tolist(),
        "radius_mm": one.radius_mm,
        "angle_deg": one.angle_deg.tolist(),
        "radial_um": one.radial_um.tolist(),
        "figures_um": one.figures_um,
        "uncertainty_um": one.uncertainty_um,
        "by_the_noise_alone_um": one.own_um,
        "predicted_um": one.predicted_um,
        "driven": "standstills on a polygon, in the senses that were commanded",
    }
