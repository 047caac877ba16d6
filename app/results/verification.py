"""A result held against a measurement that it was not made from.

The tracker stands anywhere, so its pose is taken out of the measurement and of the
prediction in the same way: both are stated less their best-fit rigid motion over the
measured places, each component counting the same. Then, at each place,

    measured   what the machine is off its nominal now
    predicted  what the result says it is off, with what a controller adds if it does
    deviation  measured less predicted

A tolerance is held against measured and against the deviation by ISO 14253-1, with the
uncertainty of the measurement alone: the truth is compared with what was stated.
Whether the result's own uncertainty is right is another question: deviations are
consistent if χ² = dᵀ (V + J C Jᵀ)⁻¹ d, pose and seats fitted, is what V of the noise
and C of the result allow.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64
from scipy.linalg import block_diag
from scipy.special import fdtrc

from truepath.app.alignment.left_out import LeftOut
from truepath.app.alignment.observations import Observations
from truepath.app.errors import BadInput, Unidentifiable
from truepath.app.estimation.extrapolation import (
    beyond_travel_variance_mm2,
    estimate_variations,
    full_travel,
)
from truepath.app.estimation.known_effects import (
    KnownEffects,
    extract_known_effects,
)
from truepath.app.estimation.noise import NoiseModel, raise_noise
from truepath.app.estimation.noise_fit import guess_noise, refine_runs
from truepath.app.estimation.runs import RunInput
from truepath.app.files.one_machine import one_machine
from truepath.app.files.result_file import CalibrationResult
from truepath.app.files.run import Run, RunSummary, summarize_run
from truepath.app.files.units import UM_PER_MM
from truepath.app.kinematics.coarse_model import build_run_models
from truepath.app.kinematics.conditions import Conditions
from truepath.app.kinematics.machine import Machine
from truepath.app.kinematics.model import MachineModel
from truepath.app.kinematics.second_order import compute_second_order_mm
from truepath.app.progress import Progress, ignore_progress
from truepath.app.results.circles_in_motion import (
    CirclesInMotion,
    evaluate_circles,
    join_circles,
)
from truepath.app.results.driven_figures import DrivenFigures, evaluate_driven
from truepath.app.results.length_statistics import (
    DRAWS,
    LengthStatistics,
    state_measured,
    state_predicted,
)
from truepath.app.results.measured_places import (
    MeasuredPlaces,
    join_places,
    reduce_to_places,
)
from truepath.app.results.parts_of_run import align_parts
from truepath.app.results.place_conformity import PlaceConformity, decide_places

K = 2.0
# Chances below which deviations are not consistent, and a measurement is in doubt.
_LIKELY, DOUBTFUL = 0.05, 0.01
_FREE = 10.0  # stated uncertainties that a machine which has changed may be off
_ROUNDING = 1e-12
_FEWEST = 8.0  # degrees of freedom by which the noise of a Run is known at the least
_ROUNDS, _SAME_NOISE = 6, 0.01  # three or four settle it to a hundredth

Correction = Callable[[Conditions], Float64[np.ndarray, "n 3"]]
"""What a controller adds at the conditions of cells, mm."""


@dataclass(frozen=True, slots=True)
class PlaceVectors:
    """A vector at each place, less rigid motion; covariance : (n, 3, 3) of it."""

    vector_mm: Float64[np.ndarray, "n 3"]
    covariance_mm2: Float64[np.ndarray, "n 3 3"]

    @property
    def length_um(self) -> Float64[np.ndarray, " n"]:
        """Lengths."""
        return UM_PER_MM * np.linalg.norm(self.vector_mm, axis=1)

    @property
    def length_sigma_um(self) -> Float64[np.ndarray, " n"]:
        """Standard uncertainty of a length: that of the direction known least."""
        largest = np.linalg.eigvalsh(self.covariance_mm2)[:, -1]
        return UM_PER_MM * np.sqrt(np.maximum(largest, 0.0))

    @property
    def sigma_um(self) -> Float64[np.ndarray, "n 3"]:
        """Standard uncertainties of the components."""
        variance = np.diagonal(self.covariance_mm2, axis1=1, axis2=2)
        return UM_PER_MM * np.sqrt(np.maximum(variance, 0.0))


@dataclass(frozen=True, slots=True)
class Consistency:
    """χ² of deviations, and how likely a larger one is if all is as stated.

    The noise is known by the Run itself, as well as it has data beyond those that a
    free machine takes up: the chance is that of an F distribution.

    share_within : of components that are within their expanded uncertainty (k = 2)
    known_by : degrees of freedom by which the Run knows its noise
    repeated : chance of what a machine free to err otherwise leaves: small where the
        measurement itself does not fit together
    """

    chi_square: float
    freedom: int
    chance: float
    share_within: float
    known_by: float
    repeated: float

    @property
    def is_consistent(self) -> bool:
        """Whether the deviations are what noise and stated uncertainty allow."""
        return self.chance >= _LIKELY

    @property
    def fits_together(self) -> bool:
        """Whether some machine, changed in any way, would explain the measurement."""
        return self.repeated >= DOUBTFUL


@dataclass(frozen=True, slots=True)
class MapScale:
    """How much of the result's map the machine still has: 1 as found, 0 compensated.

    Near 2 the controller adds the correction with the wrong sign.
    """

    value: float
    uncertainty: float


@dataclass(frozen=True, slots=True)
class VerifiedRun:
    """A Run, or a part of one that went on, that a result was held against.

    samples : used and offered
    """

    summary: RunSummary
    noise: NoiseModel
    samples: tuple[int, int]
    left_out: tuple[LeftOut, ...]


@dataclass(frozen=True, slots=True)
class Verification:
    """What a measurement says of a result.

    deviation : its covariance is that of the measurement; combined_mm2 with the result
    statistics : of lengths: `measured`, `predicted`, `deviation`
    conformity : of `measured` and `deviation` where there is a tolerance
    driven : figures of ISO 230-2, -4 and -6 where lines and circles were measured
    circles : that were driven on the fly
    """

    result: CalibrationResult
    runs: tuple[VerifiedRun, ...]
    places: MeasuredPlaces
    measured: PlaceVectors
    predicted: PlaceVectors
    deviation: PlaceVectors
    combined_mm2: Float64[np.ndarray, "n 3 3"]
    statistics: dict[str, LengthStatistics]
    consistency: Consistency
    scale: MapScale | None
    conformity: dict[str, PlaceConformity]
    tolerance_um: float | None
    is_compensated: bool
    driven: DrivenFigures
    circles: CirclesInMotion


def verify(
    result: CalibrationResult,
    *runs: Run,
    first_row: Sequence[int] = (0,),
    tolerance_um: float | None = None,
    correction: Correction | None = None,
    on_progress: Progress = ignore_progress,
) -> Verification:
    """Hold a result against a Run that it was not made from, or against its parts.

    first_row : of the plan, that each part of a Run begins with
    tolerance_um : largest length that a deviation may have
    correction : what the controller added while it was measured, if it did

    Raises BadInput if the result was made from this Run, BundleError if it is of
    another machine, EstimationError if the data do not carry the answer.
    """
    on_progress(0.0, "aligning")
    summaries = [summarize_run(run) for run in runs]
    for run, summary in zip(runs, summaries, strict=True):
        refuse_used_run(result, summary)
        one_machine([result.machine, run.machine], ["the result", run.name])
    parts = align_parts(runs, first_row)
    if correction is not None:
        _refuse_turning(runs[0].machine)
    on_progress(0.4, "estimating")
    found = _find_poses(result, [part.seen for part in parts], correction)
    places = [
        reduce_to_places(part.own, one.pose, one.noise)
        for part, one in zip(parts, found, strict=True)
    ]
    _require_enough(places)
    held = _Held.join([_Held.of(result, one, correction) for one in places])
    on_progress(0.8, "reporting")
    verified = tuple(
        VerifiedRun(
            summary, one.noise, (part.seen.used, part.seen.offered), part.own.left_out
        )
        for summary, part, one in zip(summaries, parts, found, strict=True)
    )
    circles = join_circles(
        [
            evaluate_circles(
                run,
                part.seen,
                one,
                result,
                lambda at: predict_displacement(result, at, correction),
                first,
            )
            for run, part, one, first in zip(runs, parts, found, first_row, strict=True)
        ]
    )
    return replace(_state(held, verified, tolerance_um, correction), circles=circles)


def _require_enough(parts: Sequence[MeasuredPlaces]) -> None:
    """Raise Unidentifiable where places do not tell where the tracker stands."""
    for places in parts:
        if len(places.owner) <= places.nuisance.shape[1]:
            raise Unidentifiable(
                f"{len(places)} places were measured, too few to tell where the "
                "tracker stands; measure more"
            )


def refuse_used_run(result: CalibrationResult, run: RunSummary) -> None:
    """Raise BadInput if a result was made from a Run: it would confirm itself."""
    runs = result.provenance.get("runs") or ()
    used = {each.get("input_sha256") for each in runs}
    if run.digest in used | {result.provenance.get("input_sha256")}:
        raise BadInput(
            f"{run.name}: the result was made from this measurement, which cannot "
            "verify it; measure again, best by a plan of verification"
        )


def _refuse_turning(machine: Machine) -> None:
    """Raise BadInput where what a controller adds is not along the tracker's frame."""
    from_base = machine.tracker.stands_on == "base" and machine.workpiece_side
    if machine.rotary_axes or from_base:
        raise BadInput(
            f"{machine.name}: what a compensation leaves is verified on machines of "
            "linear axes, with the tracker on the workpiece; verify it without naming "
            "the compensation: the machine as it is is stated in any case"
        )


def _find_poses(
    result: CalibrationResult,
    parts: Sequence[Observations],
    correction: Correction | None,
) -> Sequence[RunInput]:
    """Return the pose and the noise of each part, whatever its machine is.

    The noise is that beside a machine which is free to err otherwise than the result
    says, so that what the result gets wrong does not pass for noise. Of what the result
    explains nothing is left to be taken for errors: noise is not lost to them either.
    """
    known = extract_known_effects(
        result.model, np.zeros(result.model.size), result.covariance
    ).loosen()
    offsets = [part.at.offset_mm for part in parts]
    models = build_run_models(result.machine, offsets, known.effects)
    starts = [_take_off(result, part, correction) for part in parts]
    try:
        return _settle_noise(models.coarse, starts, known)
    except Unidentifiable:  # too few places to tell: as loud as is usual
        return [replace(one, noise=raise_noise(one.noise)) for one in starts]


def _take_off(
    result: CalibrationResult, part: Observations, correction: Correction | None
) -> RunInput:
    """Return what a result leaves unexplained of a part, with its rough pose."""
    moved = predict_displacement(result, part.at, correction)
    rest = replace(part, tracker_mm=part.tracker_mm - moved @ part.pose.rotation.T)
    return RunInput(rest, part.pose, guess_noise(part, perpendicular_only=False))


def _settle_noise(
    model: MachineModel, starts: Sequence[RunInput], known: KnownEffects
) -> Sequence[RunInput]:
    """Return pose and noise with how far the machine errs judged by that same noise.

    By a noise that is too low, some of it passes for error of the free machine, which
    the next noise then lacks: few places cannot tell, so both are found in turn.
    """
    found: Sequence[RunInput] = starts
    for _ in range(_ROUNDS):
        before = [
            replace(start, pose=one.pose, noise=one.noise)
            for start, one in zip(starts, found, strict=True)
        ]
        found = refine_runs(model, before, known=known)
        now, last = ([one.noise.ou for one in runs] for runs in (found, before))
        if np.allclose(now, last, rtol=_SAME_NOISE, atol=0.0):
            break
    return found


def predict_displacement(
    result: CalibrationResult, at: Conditions, correction: Correction | None = None
) -> Float64[np.ndarray, "n 3"]:
    """Return how far off nominal the target is, as errors and controller move it."""
    moved = result.model.displacement_mm(at, result.theta)
    moved = moved + compute_second_order_mm(result.model, at, result.theta)
    return moved if correction is None else moved + correction(at)


@dataclass(frozen=True)
class _Held:
    """Measurement and prediction at places, in their m components, mm.

    columns : (m, p) of the result's parameters; bend_mm2 : (m,) beyond its tables
    less_rigid : (m, m) takes the best-fit pose and seats out of components
    """

    result: CalibrationResult
    places: MeasuredPlaces
    as_found_mm: Float64[np.ndarray, " m"]
    predicted_mm: Float64[np.ndarray, " m"]
    columns: Float64[np.ndarray, "m p"]
    bend_mm2: Float64[np.ndarray, " m"]
    less_rigid: Float64[np.ndarray, "m m"]

    @staticmethod
    def of(
        result: CalibrationResult,
        places: MeasuredPlaces,
        correction: Correction | None,
    ) -> _Held:
        model, at = result.model, places.cells
        as_found = places.project(predict_displacement(result, at))
        predicted = places.project(predict_displacement(result, at, correction))
        told = result.at_targets
        known = estimate_variations(
            told.model,
            told.theta,
            result.measured or full_travel(result.machine),
            told.covariance,
        )
        bend = beyond_travel_variance_mm2(places.at, told.model, known)
        size = len(places.owner)
        N = places.nuisance
        return _Held(
            result,
            places,
            as_found,
            predicted,
            places.project(model.jacobian(at)),
            np.einsum("mi,mi->m", places.component**2, bend[places.owner]),
            np.eye(size) - N @ np.linalg.pinv(N, rcond=_ROUNDING),
        )

    @staticmethod
    def join(parts: Sequence[_Held]) -> _Held:
        """Return several Runs as one, each without a rigid motion of its own."""
        if len(parts) == 1:
            return parts[0]
        return _Held(
            parts[0].result,
            join_places([part.places for part in parts]),
            np.concatenate([part.as_found_mm for part in parts]),
            np.concatenate([part.predicted_mm for part in parts]),
            np.concatenate([part.columns for part in parts]),
            np.concatenate([part.bend_mm2 for part in parts]),
            block_diag(*(part.less_rigid for part in parts)),
        )

    def state(
        self, value: Float64[np.ndarray, " m"], covariance: Float64[np.ndarray, "m m"]
    ) -> PlaceVectors:
        M = self.less_rigid
        return PlaceVectors(
            self.places.collect(M @ value),
            self.places.collect_covariance(M @ covariance @ M),
        )

    def predict_covariance(
        self, parameters: Float64[np.ndarray, "p p"]
    ) -> Float64[np.ndarray, "m m"]:
        spread = self.columns @ parameters @ self.columns.T
        return spread + np.diag(self.bend_mm2)

    def draw(
        self, covariance: Float64[np.ndarray, "m m"], seed: int
    ) -> Float64[np.ndarray, "n 3 d"]:
        """Return departures by a covariance, less their rigid motion."""
        value, vector = np.linalg.eigh(covariance)
        unit = np.random.default_rng(seed).standard_normal((len(value), DRAWS))
        drawn = (vector * np.sqrt(np.maximum(value, 0.0))) @ unit
        return self.places.collect(self.less_rigid @ drawn)

    def compute_chi_square(
        self, covariance: Float64[np.ndarray, "m m"]
    ) -> tuple[float, int]:
        """Return χ² of the deviations, pose and seats fitted, and its freedom."""
        deviation = self.places.residual_mm - self.predicted_mm
        factor = np.linalg.cholesky(self.places.noise_mm2 + covariance)
        whitened = np.linalg.solve(
            factor, np.column_stack([deviation, self.places.nuisance])
        )
        data, taken = whitened[:, 0], _orthonormalise(whitened[:, 1:])
        left = data - taken @ (taken.T @ data)
        return float(left @ left), len(data) - taken.shape[1]

    def match_chi_square(
        self,
        covariance: Float64[np.ndarray, "m m"],
        true: Float64[np.ndarray, "m m"],
    ) -> tuple[float, float]:
        """Return scale and freedom of the χ² by one covariance where another is true.

        Its first two moments (Satterthwaite 1946), pose and seats taken off.
        """
        V = self.places.noise_mm2
        ratio = np.linalg.solve(V + covariance, V + true)
        mean = float(np.trace(ratio)) - self.places.nuisance.shape[1]
        square = float(np.sum(ratio * ratio.T))
        mean = max(mean, 1.0)
        scale = square / mean
        return scale, mean / scale


def _state(
    held: _Held,
    runs: tuple[VerifiedRun, ...],
    tolerance_um: float | None,
    correction: Correction | None,
) -> Verification:
    places, result = held.places, held.result
    spread = held.predict_covariance(result.covariance)
    residual, V = places.residual_mm, places.noise_mm2
    measured = held.state(residual, V)
    predicted = held.state(held.predicted_mm, spread)
    deviation = held.state(residual - held.predicted_mm, V)
    combined = measured.covariance_mm2 + predicted.covariance_mm2
    drawn, departures = held.draw(V, 1), held.draw(spread, 2)
    consistency = _judge_consistency(held, spread)
    conformity = {
        name: decide_places(
            one.length_um, one.length_sigma_um, consistency.known_by, tolerance_um
        )
        for name, one in (("measured", measured), ("deviation", deviation))
        if tolerance_um is not None
    }
    return Verification(
        result,
        runs,
        places,
        measured,
        predicted,
        deviation,
        combined,
        {
            "measured": state_measured(measured.vector_mm, drawn, consistency.known_by),
            "predicted": state_predicted(predicted.vector_mm, departures),
            "deviation": state_measured(
                deviation.vector_mm, drawn, consistency.known_by
            ),
        },
        consistency,
        _find_scale(held),
        conformity,
        tolerance_um,
        correction is not None,
        evaluate_driven(places, measured.vector_mm, predicted.vector_mm, drawn),
        CirclesInMotion(),
    )


def _judge_consistency(
    held: _Held,
    spread: Float64[np.ndarray, "m m"],
) -> Consistency:
    chi_square, freedom = held.compute_chi_square(spread)
    free = held.predict_covariance(_FREE**2 * held.result.covariance)
    _, noise_freedom = held.match_chi_square(free, np.zeros_like(free))
    known_by = max(noise_freedom, _FEWEST)
    rest, _ = held.compute_chi_square(free)
    scale, rest_freedom = held.match_chi_square(free, spread)
    M = held.less_rigid
    off = M @ (held.places.residual_mm - held.predicted_mm)
    sigma = np.sqrt(np.diag(M @ (held.places.noise_mm2 + spread) @ M))
    return Consistency(
        chi_square,
        freedom,
        float(fdtrc(freedom, known_by, chi_square / freedom)),
        float(np.mean(np.abs(off) <= K * sigma)),
        known_by,
        float(fdtrc(rest_freedom, known_by, rest / scale / rest_freedom)),
    )


def _find_scale(held: _Held) -> MapScale | None:
    """Return how much of the map is in the measurement; None where it has no errors."""
    factor = np.linalg.cholesky(held.places.noise_mm2)
    columns = [held.places.residual_mm, held.as_found_mm, held.places.nuisance]
    white = np.linalg.solve(factor, np.column_stack(columns))
    data, taken = white[:, 0], _orthonormalise(white[:, 2:])
    shape = white[:, 1] - taken @ (taken.T @ white[:, 1])
    square = float(shape @ shape)
    if square < 1.0:
        return None
    return MapScale(float(shape @ data) / square, square**-0.5)


def _orthonormalise(columns: Float64[np.ndarray, "m k"]) -> Float64[np.ndarray, "m r"]:
    """Return an orthonormal basis of what columns span."""
    unit = columns / np.linalg.norm(columns, axis=0)
    basis, size, _ = np.linalg.svd(unit, full_matrices=False)
    return basis[:, size > 1e-10 * size[0]]
