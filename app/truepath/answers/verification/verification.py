"""A result compared with a measurement that it was not made from.

The station of the tracker is arbitrary, so its pose is removed from the measurement and
from the prediction in the same way: both are stated less their best-fit rigid motion
over the measured points, each component counting the same. Then, at each point,

    measured   displacement of the machine from nominal now
    predicted  that by the result, with what a controller adds if it does
    deviation  measured less predicted

Measured and deviation are tested against a tolerance by ISO 14253-1, with the
uncertainty of the measurement alone: the truth is compared with what was stated. It has
the noise of each point, and what all points share: the scale of air and tracker, and
the errors of a tracker within its specification. That of the calibrating measurement is
in the result's own uncertainty; nothing is taken to be common to both, as if the
tracker were another one.

Whether the result's own uncertainty is right is another question: deviations are
consistent if χ² = dᵀ (V + J C Jᵀ)⁻¹ d, pose and seats fitted, is what V of the
measurement and C of the result allow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Float64

from truepath.alignment.align import align_all
from truepath.alignment.observations.observations import Observations
from truepath.alignment.stream.left_out import NOT_MEASURED, LeftOut
from truepath.answers.shown.sampled_vectors import SampledVectors
from truepath.answers.verification.circles.circular_test import (
    CirclesInMotion,
    evaluate_circles,
    join_circles,
)
from truepath.answers.verification.places.error_ratio import MapScale, find_map_scale
from truepath.answers.verification.places.length_statistics import (
    LengthStatistics,
    compute_measured_statistics,
    compute_predicted_statistics,
)
from truepath.answers.verification.places.matched_points import (
    Consistency,
    MatchedPoints,
    PointVectors,
    assess_consistency,
)
from truepath.answers.verification.places.multipoint_conformity import (
    PointConformity,
    decide_points,
)
from truepath.answers.verification.places.predicted_motion import (
    Correction,
    find_poses,
    predict_displacement,
)
from truepath.answers.verification.places.reduced_points import (
    ReducedPoints,
    reduce_to_points,
)
from truepath.answers.verification.static_test_figures import (
    StaticTestFigures,
    evaluate_static_lines_and_circles,
)
from truepath.errors import BadInput, Unidentifiable
from truepath.estimation.problem.noise import NoiseModel
from truepath.files.bundle.one_machine import one_machine
from truepath.files.bundle.run import Run, RunSummary, share_samples, summarize_run
from truepath.files.earlier.result_file import CalibrationResult
from truepath.files.earlier.verdict import Verdict
from truepath.files.environment import state_length_ppm
from truepath.kinematics.effects.instrument import (
    TrackerErrors,
    list_instrument_errors,
)
from truepath.kinematics.machine.machine import Machine
from truepath.progress import Progress, ignore_progress
from truepath.results.result_assessment import assess_air, assess_sensors


@dataclass(frozen=True, slots=True)
class VerifiedRun:
    """A Run, or a part of a continued one, that a result was compared with.

    samples : used and offered
    scale_ppm : standard uncertainty that all its lengths have in common
    """

    summary: RunSummary
    noise: NoiseModel
    samples: tuple[int, int]
    left_out: tuple[LeftOut, ...]
    scale_ppm: float


@dataclass(frozen=True, slots=True)
class Verification:
    """Comparison of a result with a measurement.

    run_verdict : on the measurement itself
    deviation : its covariance is that of the measurement; combined_mm2 with the result
    statistics : of lengths: `measured`, `predicted`, `deviation`
    conformity : of `measured` and `deviation` where there is a tolerance
    driven : figures of ISO 230-2, -4 and -6 where lines and circles were measured
    circles : those executed on the fly
    """

    result: CalibrationResult
    runs: tuple[VerifiedRun, ...]
    run_verdict: Verdict
    places: ReducedPoints
    measured: PointVectors
    predicted: PointVectors
    deviation: PointVectors
    combined_mm2: Float64[np.ndarray, "n 3 3"]
    statistics: dict[str, LengthStatistics]
    consistency: Consistency
    scale: MapScale | None
    conformity: dict[str, PointConformity]
    tolerance_um: float | None
    is_compensated: bool
    driven: StaticTestFigures
    circles: CirclesInMotion


def verify(
    result: CalibrationResult,
    *runs: Run,
    first_row: Sequence[int] = (0,),
    tolerance_um: float | None = None,
    correction: Correction | None = None,
    on_progress: Progress = ignore_progress,
) -> Verification:
    """Compare a result with a Run that it was not made from, or with its parts.

    first_row : of the plan, that each part of a Run begins with
    tolerance_um : largest length that a deviation may have
    correction : what the controller added during the measurement, if it did

    Raises BadInput if the result was made from this Run, BundleError if it is of
    another machine, EstimationError if the data do not determine the answer.
    """
    on_progress(0.0, "aligning")
    summaries = [summarize_run(run) for run in runs]
    for run, summary in zip(runs, summaries, strict=True):
        _reject_used_run(result, summary)
        one_machine([result.machine, run.machine], ["the result", run.name])
    parts = _align_parts(runs, first_row)
    if correction is not None:
        _reject_turning(runs[0].machine)
    on_progress(0.4, "estimating")
    found = find_poses(result, [part.seen for part in parts], correction)
    places = [
        reduce_to_points(part.own, one.pose, one.noise)
        for part, one in zip(parts, found, strict=True)
    ]
    _require_enough(places)
    ppm = [state_length_ppm(r.refraction, r.machine.tracker.range_ppm) for r in runs]
    errors = list_instrument_errors([one.cells for one in places])
    held = MatchedPoints.join(
        [
            MatchedPoints.of(result, one, correction, errors, scale)
            for one, scale in zip(places, ppm, strict=True)
        ]
    )
    on_progress(0.8, "reporting")
    verified = tuple(
        VerifiedRun(
            summary,
            one.noise,
            (part.seen.used, part.seen.offered),
            part.own.left_out,
            scale,
        )
        for summary, part, one, scale in zip(summaries, parts, found, ppm, strict=True)
    )
    predict = partial(predict_displacement, result, correction=correction)
    moving = [
        replace(each, is_moving=True) if isinstance(each, TrackerErrors) else each
        for each in errors
    ]
    circles = join_circles(
        [
            evaluate_circles(run, part.seen, one, result, predict, moving, first)
            for run, part, one, first in zip(runs, parts, found, first_row, strict=True)
        ]
    )
    return replace(_state(held, verified, tolerance_um, correction), circles=circles)


def _require_enough(parts: Sequence[ReducedPoints]) -> None:
    for places in parts:
        if len(places.owner) <= places.nuisance.shape[1]:
            raise Unidentifiable(
                f"{len(places)} places were measured, too few to tell where the "
                "tracker stands; measure more"
            )


def _reject_used_run(result: CalibrationResult, run: RunSummary) -> None:
    """Raise BadInput if a result was made from a Run or from a part of it.

    It would confirm itself.
    """
    runs = result.provenance.get("runs") or ()
    used = {each.get("input_sha256") for each in runs}
    whole = run.digest in used | {result.provenance.get("input_sha256")}
    if whole or any(share_samples(each.get("sketch", ""), run.sketch) for each in runs):
        made = "this measurement" if whole else "samples of this measurement"
        raise BadInput(
            f"{run.name}: the result was made from {made}, which cannot "
            "verify it; measure again, best by a plan of verification"
        )


def _reject_turning(machine: Machine) -> None:
    from_base = machine.tracker.stands_on == "base" and machine.workpiece_side
    if machine.rotary_axes or from_base:
        raise BadInput(
            f"{machine.name}: what a compensation leaves is verified on machines of "
            "linear axes, with the tracker on the workpiece; verify it without naming "
            "the compensation: the machine as it is is stated in any case"
        )


def _state(
    held: MatchedPoints,
    runs: tuple[VerifiedRun, ...],
    tolerance_um: float | None,
    correction: Correction | None,
) -> Verification:
    places, residual = held.places, held.places.residual_mm
    spread, V = held.predict_covariance(), held.covariance_mm2
    measured = held.to_point_vectors(residual, V)
    predicted = held.to_point_vectors(held.predicted_mm, spread)
    deviation = held.to_point_vectors(residual - held.predicted_mm, V)
    noise = held.draw(places.noise_mm2, 1)
    tracker = held.draw(places.noise_mm2 + held.tracker_mm @ held.tracker_mm.T, 1)
    scale_mm = places.collect(held.less_rigid @ held.scale_mm)
    consistency = assess_consistency(held, spread)
    known_by = consistency.known_by
    summaries = [one.summary for one in runs]
    return Verification(
        held.result,
        runs,
        Verdict.merge(
            [
                assess_air(
                    [one.refraction for one in summaries], [s.name for s in summaries]
                ),
                assess_sensors(summaries),
            ]
        ),
        places,
        measured,
        predicted,
        deviation,
        measured.covariance_mm2 + predicted.covariance_mm2,
        {
            "measured": compute_measured_statistics(
                measured.vector_mm, tracker, known_by, scale_mm
            ),
            "predicted": compute_predicted_statistics(
                predicted.vector_mm, held.draw(spread, 2)
            ),
            "deviation": compute_measured_statistics(
                deviation.vector_mm, tracker, known_by, scale_mm
            ),
        },
        consistency,
        find_map_scale(held, is_compensated=correction is not None),
        _decide(places, measured, deviation, known_by, tolerance_um),
        tolerance_um,
        correction is not None,
        evaluate_static_lines_and_circles(
            places,
            SampledVectors(
                measured.vector_mm,
                noise,
                places.collect(held.less_rigid @ held.common_mm),
            ),
            predicted.vector_mm,
        ),
        CirclesInMotion(),
    )


def _decide(
    places: ReducedPoints,
    measured: PointVectors,
    deviation: PointVectors,
    known_by: float,
    tolerance_um: float | None,
) -> dict[str, PointConformity]:
    if tolerance_um is None:
        return {}
    return {
        name: decide_points(
            one.length_um,
            one.length_sigma_um,
            known_by,
            tolerance_um,
            sees_all=places.sees_all,
        )
        for name, one in (("measured", measured), ("deviation", deviation))
    }


@dataclass(frozen=True)
class _PartOfRun:
    seen: Observations  # all of it, which determines its pose
    own: Observations  # what counts, by the rows of the plan


def _align_parts(runs: Sequence[Run], first_row: Sequence[int]) -> list[_PartOfRun]:
    # The parts of an interrupted verification are aligned separately. Every standstill
    # counts once, in the last part that begins before it: its approach is as planned
    # only where the previous row was executed as well, so the first row of a further
    # part that an earlier part has measured only leads to the next.
    seen = [_align_alone(run, number) for number, run in enumerate(runs)]
    begins: list[int] = []
    parts: list[_PartOfRun] = []
    for number, first in enumerate(first_row):
        rows_before = (
            row + first_row[k] for k in range(number) for row in seen[k].measured_rows
        )
        begins.append(first + (first in rows_before))
    for number, (one, first) in enumerate(zip(seen, first_row, strict=True)):
        end = min(begins[number + 1 :], default=np.inf)
        parts.append(_PartOfRun(one, _select(one, first, begins[number], end)))
    return parts


def _align_alone(run: Run, number: int) -> Observations:
    # Each has a number of its own, as it shares neither noise nor seats with another.
    (seen,) = align_all([run], [run.name])
    return replace(seen, at=replace(seen.at, run=number))


def _select(seen: Observations, first: int, begin: int, end: float) -> Observations:
    # Rows of the plan from `begin` to before `end`; `first` : where the part begins
    row = seen.row + first
    counts = np.flatnonzero((row >= begin) & (row < end))
    own = replace(seen, row=row).select(counts)
    left_out = (
        replace(each, row=each.row + first if each.row >= 0 else each.row)
        for each in seen.left_out
        if each.cause not in NOT_MEASURED or begin <= each.row + first < end
    )
    return replace(own, left_out=tuple(left_out))
