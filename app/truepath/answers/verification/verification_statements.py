"""Findings of a verification, in sentences."""

from __future__ import annotations

from collections.abc import Iterator

from truepath.answers.shown.number_format import format_number
from truepath.answers.verification.circles.circles_json import state_circles
from truepath.answers.verification.places.conformity import Conformity
from truepath.answers.verification.places.error_ratio import ScaleCause
from truepath.answers.verification.places.matched_points import K
from truepath.answers.verification.verification import Verification, VerifiedRun
from truepath.results.result_json import describe_refraction

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


def state_findings(found: Verification) -> Iterator[str]:
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
            f"{len(found.places)} places is {_um(one.length_um)} ± "
            f"{_um(one.expanded_um)} µm against {one.tolerance_um:g} µm "
            f"(k = {one.coverage_factor:.1f}, so that all places lie within together "
            "in 95 % of cases)."
        )
    yield from map(str, found.run_verdict.reasons)
    yield from _state_unseen(found)
    yield from _state_resting(found)
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
    """An error along the line of travel is in no figure."""
    if found.places.is_complete:
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


def _state_resting(found: Verification) -> Iterator[str]:
    if resting := found.places.resting_axes:
        yield (
            f"Not driven: {', '.join(resting)}. What the machine errs by as "
            f"{'it moves' if len(resting) == 1 else 'they move'} was not measured; "
            "drive every axis that the tolerance is to hold for."
        )


def _state_air(run: VerifiedRun) -> str:
    return (
        "The ranges of the verifying measurement are "
        f"{describe_refraction(run.summary.refraction)}; "
        f"{format_number(K * run.scale_ppm, 2)} ppm (k = 2) of scale, of air and "
        "tracker, common to all places, are part of its uncertainty."
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
    if found.scale is not None and found.scale.cause is not None:
        return (
            "Measurement and result do not agree: the compensation of the control is "
            f"not what it is taken for; {figures}."
        )
    return (
        "Measurement and result do not agree, and no machine of this model explains "
        f"the measurement either: look at tracker and reflector first; {figures}."
    )


def _state_scale(found: Verification) -> Iterator[str]:
    scale = found.scale
    if scale is None or scale.cause is None:
        return
    yield (
        f"The machine errs by {scale.value:.2f} times what the result says of "
        f"it as found, where {scale.expected:.2f} times is expected: "
        f"{_SCALE_CAUSES[scale.cause]}."
    )


def _um(value: float) -> str:
    return format_number(value, 2)
