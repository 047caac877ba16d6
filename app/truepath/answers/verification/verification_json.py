"""A verification as `verification.json` (schema `verification/1`), and in sentences."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

import numpy as np

from truepath.answers.shown.page import format_expanded, format_number
from truepath.answers.verification.circle_figures import (
    OTHER_FEED,
    SECTOR_DEG,
    Sectors,
    StatedFigures,
    fit_centre,
    list_sector_angles,
)
from truepath.answers.verification.circular_test import CircleInMotion, CirclesInMotion
from truepath.answers.verification.conformity import Conformity, PointConformity
from truepath.answers.verification.matched_points import K, PointVectors, ScaleCause
from truepath.answers.verification.static_tests import CircleFigures, LineFigures
from truepath.answers.verification.verification import Verification, VerifiedRun
from truepath.files.earlier.verdict import verdict_json
from truepath.results.result_json import describe_refraction, environment_json

_SCALE_CAUSES: dict[ScaleCause, str] = {
    "wrong-sign": "the controller adds the compensation with the wrong sign",
    "not-active": "the compensation is not active",
    "active": "a compensation is active; name it to hold what it leaves",
}
_DECISIONS = {
    Conformity.WITHIN: "passes",
    Conformity.OUTSIDE: "fails",
    Conformity.UNDECIDED: "cannot be said to pass or fail",
}


def circles_json(found: CirclesInMotion) -> dict[str, Any]:
    """`circles_in_motion`, and the rows of `circles_missing`."""
    return {
        "circles_in_motion": [_moving_circle_json(one) for one in found.circles],
        "circles_missing": list(found.broken),
    }


def _describe_circles(found: CirclesInMotion) -> Iterator[str]:
    for one in found.circles:
        figures = ", ".join(
            f"{name} {format_expanded(value, one.measured.uncertainty_um[name])}"
            for name, value in one.measured.value_um.items()
            if name in ("H", "G", "F_max", "F_min")
        )
        yield (
            f"Circle in {one.commanded.plane} on the fly, diameter "
            f"{2.0 * one.commanded.radius_mm:g} mm at "
            f"{one.commanded.feed_mm_min:g} mm/min: {figures} µm (k = 2)."
        )
        compared = _compare_figures(one)
        if unlike := [name for name in compared if not compared[name]["within"]]:
            yield (
                f"The result does not predict {', '.join(unlike)} of that circle "
                "within what both state: look for what moves, play and following "
                "errors of the drives, at this feed."
            )
        for sense, driven in one.driven.items():
            share = driven.feed_mm_min / one.commanded.feed_mm_min
            if abs(share - 1.0) > OTHER_FEED:
                yield (
                    f"That circle was driven {sense} at {driven.feed_mm_min:.0f} "
                    "mm/min: its figures are those of this feed."
                )
    for row in found.broken:
        yield (
            f"The circle to row {row + 1} was not driven whole, without a stop and in "
            "its sense, or not seen all round, as often as it was driven: it tells "
            "nothing. Drive it again."
        )


def _compare(
    value: float, sigma: float, predicted: float, predicted_sigma: float
) -> dict[str, float | bool]:
    difference = value - predicted
    expanded = K * float(np.hypot(sigma, predicted_sigma))
    within = abs(difference) <= expanded
    return {"value": difference, "expanded_uncertainty": expanded, "within": within}


def _compare_figures(one: CircleInMotion) -> dict[str, dict[str, float | bool]]:
    sigma, predicted_sigma = one.measured.uncertainty_um, one.predicted_uncertainty_um
    return {
        name: _compare(
            value, sigma[name], one.predicted_um[name], predicted_sigma[name]
        )
        for name, value in one.measured.value_um.items()
    }


def _fit_centre(radial_um: dict[str, Sectors]) -> list[float]:
    """Centre of the circle of least squares of all senses."""
    return fit_centre(np.mean(list(radial_um.values()), axis=0)[:, None])[:, 0].tolist()


def _moving_circle_json(one: CircleInMotion) -> dict[str, Any]:
    return {
        "plane": one.commanded.plane,
        "standard": "iso-230-4",
        "diameter_mm": 2.0 * one.commanded.radius_mm,
        "feed_mm_min": one.commanded.feed_mm_min,
        "driven_feed_mm_min": {s: d.feed_mm_min for s, d in one.driven.items()},
        "row": one.row,
        "samples": {sense: driven.samples for sense, driven in one.driven.items()},
        "sector_deg": SECTOR_DEG,
        "angle_deg": list_sector_angles().tolist(),
        "radial_um": {sense: r.tolist() for sense, r in one.radial_um.items()},
        "predicted_radial_um": {s: r.tolist() for s, r in one.expected_um.items()},
        "centre_um": {
            "measured": _fit_centre(one.radial_um),
            "predicted": _fit_centre(one.expected_um),
        },
        **_figures_json(one.measured),
        "predicted_um": one.predicted_um,
        "predicted_uncertainty_um": one.predicted_uncertainty_um,
        "difference_um": _compare_figures(one),
    }


def describe_findings(found: Verification) -> Iterator[str]:
    """One sentence per finding, the most important first."""
    state = "with its compensation active" if found.is_compensated else "as it is"
    for name, one in found.conformity.items():
        what = (
            f"The machine {state}"
            if name == "measured"
            else "The result, as a prediction of the machine,"
        )
        yield (
            f"{what} {_DECISIONS[one.conformity]}: the worst of "
            f"{len(found.points)} places is {_um(one.length_um)} ± "
            f"{_um(one.expanded_um)} µm against {one.tolerance_um:g} µm "
            f"(k = {one.coverage_factor:.1f}, so that all places lie within together "
            "in 95 % of cases)."
        )
    yield from map(str, found.run_verdict.reasons)
    yield from _describe_unmeasured(found)
    yield _describe_agreement(found)
    scale = found.scale
    if scale is not None and scale.cause is not None:
        yield (
            f"The machine errs by {scale.value:.2f} times what the result says of "
            f"it as found, where {scale.expected:.2f} times is expected: "
            f"{_SCALE_CAUSES[scale.cause]}."
        )
    yield from _describe_circles(found.circles)
    measured, predicted = (
        found.statistics[name]["mean"] for name in ("measured", "predicted")
    )
    yield (
        f"Mean volumetric error as measured {_um(measured.value_um)} ± "
        f"{_um(K * measured.uncertainty_um)} µm, as stated by the result "
        f"{_um(predicted.value_um)} ± {_um(K * predicted.uncertainty_um)} µm (k = 2)."
    )
    yield from dict.fromkeys(
        "The ranges of the verifying measurement are "
        f"{describe_refraction(run.summary.refraction)}; "
        f"{format_number(K * run.scale_ppm, 2)} ppm (k = 2) of scale, of air and "
        "tracker, common to all places, are part of its uncertainty."
        for run in found.runs
    )


def _describe_unmeasured(found: Verification) -> Iterator[str]:
    if not found.points.is_complete:
        yield (
            "On lines the two components across the travel are measured; an error "
            "along a line is seen by lines in other directions only."
        )
        if unseen := found.points.unseen_directions:
            yield (
                f"Nothing was measured along {' and '.join(unseen)}: whether the "
                "tolerance is kept there cannot be said; measure lines in other "
                "directions, or points."
            )
    if resting := found.points.resting_axes:
        yield (
            f"Not driven: {', '.join(resting)}. What the machine errs by as "
            f"{'it moves' if len(resting) == 1 else 'they move'} was not measured; "
            "drive every axis that the tolerance is to hold for."
        )


def _describe_agreement(found: Verification) -> str:
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
    if found.scale is not None and found.scale.cause is not None:
        return (
            "Measurement and result do not agree: the compensation of the control is "
            f"not what it is taken for; {figures}."
        )
    return (
        "Measurement and result do not agree, and no machine of this model explains "
        f"the measurement either: look at tracker and reflector first; {figures}."
    )


def _um(value: float) -> str:
    return format_number(value, 2)


def verification_json(found: Verification) -> dict[str, Any]:
    """Content of `verification.json`, except `compensation` and `asked`.

    Uncertainties are standard ones (k = 1) where their key does not say `expanded`.
    """
    first, consistency = found.runs[0], found.consistency
    measured, predicted = found.statistics["measured"], found.statistics["predicted"]
    return {
        "schema": "verification/1",
        "machine": found.result.machine.name,
        "compensated": found.is_compensated,
        "verdict": verdict_json(found.result.verdict),
        "run_verdict": verdict_json(found.run_verdict),
        "statements": list(describe_findings(found)),
        "agreement": {
            "consistent": consistency.is_consistent,
            "chi_square": consistency.chi_square,
            "freedom": consistency.freedom,
            "noise_freedom": consistency.known_by,
            "chance": consistency.chance,
            "share_within_expanded": consistency.share_within,
            "chance_of_any_machine": consistency.repeated,
        },
        "map_scale": None if found.scale is None else asdict(found.scale),
        "conformity": {
            name: _conformity_json(one, found) for name, one in found.conformity.items()
        },
        "volumetric_error_um": {
            which: {
                f"{name}{suffix}": value
                for name, one in statistics.items()
                for suffix, value in (
                    ("", one.value_um),
                    ("_uncertainty", one.uncertainty_um),
                )
            }
            for which, statistics in found.statistics.items()
        },
        "difference_um": {
            name: _compare(
                one.value_um,
                one.uncertainty_um,
                predicted[name].value_um,
                predicted[name].uncertainty_um,
            )
            for name, one in measured.items()
        },
        "directions": directions_json(found.deviation),
        "worst": _worst_json(found),
        "lines": [_line_json(one) for one in found.driven.lines],
        "circles": [_circle_json(one) for one in found.driven.circles],
        **circles_json(found.circles),
        "places": _points_json(found),
        "components": "all three"
        if found.points.is_complete
        else "three at standstills, the two across the travel on lines",
        "unseen_directions": list(found.points.unseen_directions),
        "axes_at_rest": list(found.points.resting_axes),
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


def _run_json(run: VerifiedRun) -> dict[str, Any]:
    return {
        "name": run.summary.name,
        "mode": run.summary.mode,
        "input_sha256": run.summary.digest,
        "samples_used": run.samples[0],
        "samples_offered": run.samples[1],
        "left_out": [
            {
                "cause": one.cause,
                "row": one.row,
                "from_s": one.begin_s if np.isfinite(one.begin_s) else None,
                "to_s": one.end_s if np.isfinite(one.end_s) else None,
                "samples": one.samples,
            }
            for one in run.left_out
        ],
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
        "row": int(found.points.row[one.worst]),
        "position": found.points.at.position_mm[one.worst].tolist(),
    }


def directions_json(deviation: PointVectors) -> dict[str, dict[str, float]]:
    """By direction: RMS, largest, and RMS of the standard uncertainty."""
    value_um = 1e3 * deviation.vector_mm
    return {
        name: {
            "rms_um": float(np.sqrt(np.mean(value_um[:, k] ** 2))),
            "largest_um": float(np.abs(value_um[:, k]).max()),
            "uncertainty_um": float(np.sqrt(np.mean(deviation.sigma_um[:, k] ** 2))),
        }
        for k, name in enumerate("XYZ")
    }


def _worst_json(found: Verification) -> dict[str, Any]:
    content: dict[str, Any] = {}
    for name, one in (("measured", found.measured), ("deviation", found.deviation)):
        worst = int(np.argmax(one.length_um))
        content[name] = {
            "row": int(found.points.row[worst]),
            "position": found.points.at.position_mm[worst].tolist(),
            "length_um": float(one.length_um[worst]),
            "expanded_uncertainty_um": K * float(one.length_sigma_um[worst]),
        }
    return content


def _points_json(found: Verification) -> dict[str, Any]:
    at, measured = found.points.at, found.conformity.get("measured")
    return {
        "row": found.points.row.tolist(),
        "run": found.points.run.tolist(),
        "position": at.position_mm.tolist(),
        "standstill": (at.line < 0).tolist(),
        "measured_um": (1e3 * found.measured.vector_mm).tolist(),
        "measured_uncertainty_um": found.measured.sigma_um.tolist(),
        "predicted_um": (1e3 * found.predicted.vector_mm).tolist(),
        "predicted_uncertainty_um": found.predicted.sigma_um.tolist(),
        "deviation_um": (1e3 * found.deviation.vector_mm).tolist(),
        "conformity": [one.value for one in measured.each] if measured else None,
    }


def _figures_json(stated: StatedFigures) -> dict[str, dict[str, float]]:
    return {
        "figures_um": stated.value_um,
        "uncertainty_um": stated.uncertainty_um,
        "by_the_noise_alone_um": stated.own_um,
    }


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
        **_figures_json(one.figures),
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
        **_figures_json(one.figures),
        "predicted_um": one.predicted_um,
        "driven": "standstills on a polygon, in the senses that were commanded",
    }
