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

A length of a noisy vector is too long on average: its square by the trace of the
covariance of the noise, which is subtracted. The remaining effect of the noise on a
statistic is found by adding noise once more (a parametric bootstrap; Efron & Tibshirani
1993, chapter 10) and subtracted as well; the uncertainty has its spread, the second
subtraction, the uncertainty of the size of the noise, and the scale that all points
have in common. Where noise is larger than the lengths the bootstrap shows only a part
of what noise adds to their upper end: there twice as much counts.
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
from truepath.answers.verification.circular_test import (
    CirclesInMotion,
    evaluate_circles,
    merge_circles,
)
from truepath.answers.verification.conformity import PointConformity, decide_points
from truepath.answers.verification.matched_points import (
    Consistency,
    Correction,
    MapScale,
    MatchedPoints,
    PointVectors,
    assess_consistency,
    estimate_map_scale,
    estimate_poses,
    predict_displacement,
)
from truepath.answers.verification.reduced_points import ReducedPoints, reduce_to_points
from truepath.answers.verification.static_tests import (
    SampledVectors,
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
from truepath.files.units import UM_PER_MM
from truepath.kinematics.effects.instrument import TrackerErrors, list_instrument_errors
from truepath.progress import Progress, ignore_progress
from truepath.results.result_assessment import assess_air, assess_sensors
from truepath.results.volumetric_error import TWICE, Figure, compute_scale_uncertainty

NAMES = ("mean", "p95", "largest")
_SHARE = 0.95
_SUBTRACTED = np.array([1.0, 2.0, 2.0])  # of what was taken off, by `NAMES`


LengthStatistics = dict[str, Figure]
"""By `mean`, `p95` and `largest`."""


def compute_measured_statistics(
    vector_mm: Float64[np.ndarray, "n 3"],
    noise_mm: Float64[np.ndarray, "n 3 d"],
    known_by: float,
    scale_mm: Float64[np.ndarray, "n 3"],
) -> LengthStatistics:
    """Statistics of vectors that include noise.

    noise_mm : sampled from its distribution
    known_by : degrees of freedom of the size of the noise
    scale_mm : by one standard uncertainty of the scale
    """
    added = np.mean(np.sum(noise_mm**2, axis=1), axis=1)
    length = _subtract_noise(vector_mm[:, :, None], added)
    value = _compute_statistics(UM_PER_MM * length)[:, 0]
    # Adding noise to the apparent lengths shows the bias that remains.
    seems = vector_mm * length / np.linalg.norm(vector_mm, axis=1)[:, None]
    again = _compute_statistics(
        UM_PER_MM * _subtract_noise(seems[:, :, None] + noise_mm, added)
    )
    bias = again.mean(axis=1) - value
    more = added * (1.0 + np.sqrt(2.0 / known_by))
    louder = (
        _compute_statistics(UM_PER_MM * _subtract_noise(vector_mm[:, :, None], more))[
            :, 0
        ]
        - value
    )
    scaled = vector_mm[:, :, None] + scale_mm[:, :, None] * np.array(TWICE)
    common = compute_scale_uncertainty(
        value, _compute_statistics(UM_PER_MM * _subtract_noise(scaled, added))
    )
    spread = np.sqrt(
        again.var(axis=1) + (_SUBTRACTED * bias) ** 2 + louder**2 + common**2
    )
    # Each is at least as long as the one before, whatever the noise.
    value = np.maximum.accumulate(np.maximum(value - bias, 0.0))
    return _name(value, spread)


def _subtract_noise(
    vector_mm: Float64[np.ndarray, "n 3 d"], added: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, "n d"]:
    square = np.sum(vector_mm**2, axis=1) - added[:, None]
    return np.sqrt(np.maximum(square, 0.0))


def _compute_statistics(
    length: Float64[np.ndarray, "n d"],
) -> Float64[np.ndarray, "3 d"]:
    return np.stack(
        [length.mean(axis=0), np.quantile(length, _SHARE, axis=0), length.max(axis=0)]
    )


def _name(
    value: Float64[np.ndarray, "3"], spread: Float64[np.ndarray, "3"]
) -> LengthStatistics:
    pairs = zip(value.tolist(), spread.tolist(), strict=True)
    return {name: Figure(*pair) for name, pair in zip(NAMES, pairs, strict=True)}


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
    points: ReducedPoints
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
    machine = runs[0].machine
    from_base = machine.tracker.stands_on == "base" and machine.workpiece_side
    if correction is not None and (machine.rotary_axes or from_base):
        raise BadInput(
            f"{machine.name}: what a compensation leaves is verified on machines of "
            "linear axes, with the tracker on the workpiece; verify it without naming "
            "the compensation: the machine as it is is stated in any case"
        )
    on_progress(0.4, "estimating")
    found = estimate_poses(result, [part.observed for part in parts], correction)
    points = [
        reduce_to_points(part.own, one.pose, one.noise)
        for part, one in zip(parts, found, strict=True)
    ]
    for own in points:
        if len(own.owner) <= own.nuisance.shape[1]:
            raise Unidentifiable(
                f"{len(own)} places were measured, too few to tell where the "
                "tracker stands; measure more"
            )
    ppm = [state_length_ppm(r.refraction, r.machine.tracker.range_ppm) for r in runs]
    errors = list_instrument_errors([one.cells for one in points])
    matched = MatchedPoints.join(
        [
            MatchedPoints.of(result, one, correction, errors, scale)
            for one, scale in zip(points, ppm, strict=True)
        ]
    )
    on_progress(0.8, "reporting")
    verified = tuple(
        VerifiedRun(
            summary,
            one.noise,
            (part.observed.used, part.observed.offered),
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
    circles = merge_circles(
        [
            evaluate_circles(run, part.observed, one, result, predict, moving, first)
            for run, part, one, first in zip(runs, parts, found, first_row, strict=True)
        ]
    )
    return _compare(matched, verified, tolerance_um, correction, circles)


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


def _compare(
    matched: MatchedPoints,
    runs: tuple[VerifiedRun, ...],
    tolerance_um: float | None,
    correction: Correction | None,
    circles: CirclesInMotion,
) -> Verification:
    points, residual = matched.points, matched.points.residual_mm
    spread, V = matched.predict_covariance(), matched.covariance_mm2
    measured = matched.to_point_vectors(residual, V)
    predicted = matched.to_point_vectors(matched.predicted_mm, spread)
    deviation = matched.to_point_vectors(residual - matched.predicted_mm, V)
    noise = matched.sample(points.noise_mm2, 1)
    tracker = matched.sample(
        points.noise_mm2 + matched.tracker_mm @ matched.tracker_mm.T, 1
    )
    scale_mm = points.collect(matched.less_rigid @ matched.scale_mm)
    departure_mm = matched.sample(spread, 2)
    length = np.linalg.norm(predicted.vector_mm[:, :, None] + departure_mm, axis=1)
    drawn = _compute_statistics(UM_PER_MM * length)
    consistency = assess_consistency(matched, spread)
    known_by = consistency.known_by
    summaries = [one.summary for one in runs]
    refraction = [one.refraction for one in summaries]
    air = assess_air(refraction, [one.name for one in summaries])
    return Verification(
        matched.result,
        runs,
        Verdict.merge([air, assess_sensors(summaries)]),
        points,
        measured,
        predicted,
        deviation,
        measured.covariance_mm2 + predicted.covariance_mm2,
        {
            "measured": compute_measured_statistics(
                measured.vector_mm, tracker, known_by, scale_mm
            ),
            "predicted": _name(drawn.mean(axis=1), drawn.std(axis=1)),
            "deviation": compute_measured_statistics(
                deviation.vector_mm, tracker, known_by, scale_mm
            ),
        },
        consistency,
        estimate_map_scale(matched, is_compensated=correction is not None),
        {}
        if tolerance_um is None
        else {
            name: decide_points(
                one.length_um,
                one.length_sigma_um,
                known_by,
                tolerance_um,
                sees_all=points.sees_all,
            )
            for name, one in (("measured", measured), ("deviation", deviation))
        },
        tolerance_um,
        correction is not None,
        evaluate_static_lines_and_circles(
            points,
            SampledVectors(
                measured.vector_mm,
                noise,
                points.collect(matched.less_rigid @ matched.common_mm),
            ),
            predicted.vector_mm,
        ),
        circles,
    )


@dataclass(frozen=True)
class _PartOfRun:
    observed: Observations  # all of it, which determines its pose
    own: Observations  # what counts, by the rows of the plan


def _align_parts(runs: Sequence[Run], first_row: Sequence[int]) -> list[_PartOfRun]:
    # The parts of an interrupted verification are aligned separately. Every standstill
    # counts once, in the last part that begins before it: its approach is as planned
    # only where the previous row was executed as well, so the first row of a further
    # part that an earlier part has measured only leads to the next.
    observed: list[Observations] = []
    for number, run in enumerate(runs):
        (alone,) = align_all([run], [run.name])
        # A separate number, as it shares neither noise nor seats with another.
        observed.append(replace(alone, at=replace(alone.at, run=number)))
    begins: list[int] = []
    parts: list[_PartOfRun] = []
    for number, first in enumerate(first_row):
        rows_before = (
            row + first_row[k]
            for k in range(number)
            for row in observed[k].measured_rows
        )
        begins.append(first + (first in rows_before))
    for number, (one, first) in enumerate(zip(observed, first_row, strict=True)):
        end = min(begins[number + 1 :], default=np.inf)
        parts.append(_PartOfRun(one, _select(one, first, begins[number], end)))
    return parts


def _select(observed: Observations, first: int, begin: int, end: float) -> Observations:
    # Rows of the plan from `begin` to before `end`; `first` : where the part begins
    row = observed.row + first
    counts = np.flatnonzero((row >= begin) & (row < end))
    own = replace(observed, row=row).select(counts)
    left_out = (
        replace(each, row=each.row + first if each.row >= 0 else each.row)
        for each in observed.left_out
        if each.cause not in NOT_MEASURED or begin <= each.row + first < end
    )
    return replace(own, left_out=tuple(left_out))
