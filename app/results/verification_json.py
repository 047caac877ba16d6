"""A verification as `verification.json` (schema `verification/1`), and in sentences."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any, Literal

import numpy as np
from jaxtyping import Float64

from truepath.app.alignment.left_out import LeftOut
from truepath.app.files.verdict import verdict_json
from truepath.app.results.circles_at_standstill import CircleFigures
from truepath.app.results.circles_json import circles_json, state_circles
from truepath.app.results.conformity import Conformity
from truepath.app.results.driven_figures import LineFigures
from truepath.app.results.environment_json import (
    describe_refraction,
    environment_json,
)
from truepath.app.results.held_places import K, PlaceVectors
from truepath.app.results.length_statistics import LengthStatistics
from truepath.app.results.number_format import format_number
from truepath.app.results.place_conformity import PlaceConformity
from truepath.app.results.verification import Verification, VerifiedRun

SCHEMA = "verification/1"
_DIRECTIONS = "XYZ"
ScaleCause = Literal["wrong-sign", "not-active", "active"]
_SCALE_CAUSES: dict[ScaleCause, str] = {
    "wrong-sign": "the controller adds the compensation with the wrong sign",
    "not-active": "the compensation is not active",
    "active": "a compensation is active; name it to hold what it leaves",
}
_NEARLY = 0.2  # of the map's scale, about 0 and 2
_DECISIONS = {
    Conformity.WITHIN: "passes",
    Conformity.OUTSIDE: "fails",
    Conformity.UNDECIDED: "cannot be said to pass or fail",
}


def verification_json(found: Verification) -> dict[str, Any]:
    """Return the content of `verification.json`.

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
        if found.places.is_whole
        else "three at standstills, the two across the travel on lines",
        "unseen_directions": list(found.places.unseen_directions),
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


def find_scale_cause(
    value: float, uncertainty: float, *, is_compensated: bool
) -> ScaleCause | None:
    """Return why a machine errs by so many times what was found; None if as expected.

    value, uncertainty : of the scale of the map, the standard one
    is_compensated : the controller is said to correct by files of the result
    """
    clear = 3.0 * uncertainty + _NEARLY
    if abs(value - 2.0) < clear:
        return "wrong-sign"
    if is_compensated and abs(value - 1.0) < clear:
        return "not-active"
    if not is_compensated and abs(value) < clear:
        return "active"
    return None


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
    value, uncertainty = found.scale.value, found.scale.uncertainty
    cause = find_scale_cause(value, uncertainty, is_compensated=found.is_compensated)
    return {"value": value, "uncertainty": uncertainty, "cause": cause}


def _run_json(run: VerifiedRun) -> dict[str, Any]:
    return {
        "name": run.summary.name,
        "mode": run.summary.mode,
        "input_sha256": run.summary.digest,
        "samples_used": run.samples[0],
        "samples_offered": run.samples[1],
        "left_out": [_describe_left_out(one) for one in run.left_out],
        "length_scale_ppm": run.scale_ppm,
        "environment": environment_json(run.summary),
    }


def _noise_json(run: VerifiedRun) -> dict[str, Any]:
    return {
        "white_of_stated": list(run.noise.white),
        "correlated_of_stated": list(run.noise.ou),
        "correlation_time_s": run.noise.ou_time_s,
    }


def state_findings(found: Verification) -> Iterator[str]:
    """Yield what the verification says, a sentence each, what matters most first."""
    state = "with its compensation active" if found.is_compensated else "as it is"
    for name, one in found.conformity.items():
        what = (
            f"The machine {state}"
            if name == "measured"
            else "The result, as a prediction of the machine,"
        )
        yield (
            f"{what} {_DECISIONS[one.conformity]}: the worst of "
            f"{len(found.places)} places is {_um(one.length_um)} ± "
            f"{_um(one.expanded_um)} µm against {one.tolerance_um:g} µm "
            f"(k = {one.coverage_factor:.1f}, so that all places lie within together "
            "in 95 % of cases)."
        )
    yield from map(str, found.run_verdict.reasons)
    yield from _state_unseen(found)
    yield _state_agreement(found)
    yield from _state_scale(found)
    yield from state_circles(found.circles)
    measured, predicted = (
        found.statistics[name]["mean"] for name in ("measured", "predicted")
    )
    yield (
        f"Mean volumetric error as measured {_um(measured.value_um)} ± "
        f"{_um(K * measured.uncertainty_um)} µm, as stated by the result "
        f"{_um(predicted.value_um)} ± {_um(K * predicted.uncertainty_um)} µm (k = 2)."
    )
    yield from dict.fromkeys(map(_state_air, found.runs))


def _state_unseen(found: Verification) -> Iterator[str]:
    """Yield what the lines leave unseen: an error along its line is in no figure."""
    if found.places.is_whole:
        return
    yield (
        "On lines the two components across the travel are measured; an error along "
        "a line is seen by lines in other directions only."
    )
    if unseen := found.places.unseen_directions:
        yield (
            f"Nothing was measured along {' and '.join(unseen)}: whether the tolerance "
            "is kept there cannot be said; measure lines in other directions, or "
            "points."
        )


def _state_air(run: VerifiedRun) -> str:
    """Return who corrected the ranges for the air, and what is left of their scale."""
    return (
        "The ranges of the verifying measurement are "
        f"{describe_refraction(run.summary.refraction)}; "
        f"{format_number(run.scale_ppm, 2)} ppm (k = 1) of scale, of air and tracker, "
        "common to all places, are part of its uncertainty."
    )


def _state_agreement(found: Verification) -> str:
    one = found.consistency
    figures = (
        f"chi-square {one.chi_square:.0f} with {one.freedom} degrees of freedom, "
        f"chance {100.0 * one.chance:.1f} %; {100.0 * one.share_within:.0f} % of the "
        "components lie within their expanded uncertainties (k = 2)"
    )
    if one.is_consistent:
        return f"Measurement and result agree within what both state: {figures}."
    if one.fits_together:
        return (
            "Measurement and result do not agree within what both state, and a "
            f"machine that has changed would explain it: {figures}."
        )
    return (
        "Measurement and result do not agree, and no machine of this model explains "
        f"the measurement either: look at tracker and reflector first; {figures}."
    )


def _state_scale(found: Verification) -> Iterator[str]:
    """Yield what the scale of the map says, where it is not what is expected."""
    scale = _scale_json(found)
    if scale is not None and scale["cause"] is not None:
        yield (
            f"The machine errs by {scale['value']:.2f} times what the result says of "
            f"it as found: {_SCALE_CAUSES[scale['cause']]}."
        )


def _conformity_json(one: PlaceConformity, found: Verification) -> dict[str, Any]:
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
    """Return measured less predicted of each statistic, and whether it is within U."""
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


def _directions_json(deviation: PlaceVectors) -> dict[str, Any]:
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
    """Return the places of the largest lengths."""
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


def _places_json(found: Verification) -> dict[str, Any]:
    at = found.places.at
    return {
        "row": found.places.row.tolist(),
        "position": at.position_mm.tolist(),
        "standstill": (at.line < 0).tolist(),
        "measured_um": _um_rows(found.measured.vector_mm),
        "measured_uncertainty_um": found.measured.sigma_um.tolist(),
        "predicted_um": _um_rows(found.predicted.vector_mm),
        "predicted_uncertainty_um": found.predicted.sigma_um.tolist(),
        "deviation_um": _um_rows(found.deviation.vector_mm),
    }


def _describe_left_out(one: LeftOut) -> dict[str, Any]:
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


def _um(value: float) -> str:
    return format_number(value, 2)
