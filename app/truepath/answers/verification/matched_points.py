"""Measurement and prediction at the same points, both less their rigid motion."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float64
from scipy.linalg import block_diag
from scipy.special import fdtrc

from truepath.alignment.observations.observations import Observations
from truepath.answers.verification.reduced_points import ReducedPoints, merge_points
from truepath.errors import Unidentifiable
from truepath.estimation.noise.noise_fit import guess_noise, refine_runs
from truepath.estimation.problem.noise import assume_typical_noise
from truepath.estimation.problem.normal_equations import RunInput
from truepath.estimation.problem.prior_model import (
    PriorEffects,
    extract_prior_effects,
)
from truepath.estimation.solve.extrapolation import (
    beyond_travel_variance_mm2,
    estimate_variations,
    full_travel,
)
from truepath.files.earlier.result_file import CalibrationResult
from truepath.files.units import PER_PPM, UM_PER_MM
from truepath.kinematics.coarse_model import build_run_models
from truepath.kinematics.conditions import Conditions
from truepath.kinematics.effects.base import Effect
from truepath.kinematics.effects.error_motion import compute_arm, get_typical_size
from truepath.kinematics.model import MachineModel
from truepath.kinematics.volumetric_map import compute_second_order_mm
from truepath.results.lost_motion import compute_lost_motion_mm, list_lost_departures_mm

_ROUNDS, _SAME_NOISE = 6, 0.01  # three or four settle it to a hundredth

Correction = Callable[[Conditions], Float64[np.ndarray, "n 3"]]
"""Correction by a controller at the conditions of cells, mm."""
K = 2.0
_DRAWS = 400
# Chances below which deviations are not consistent, and a measurement is in doubt.
_LIKELY, DOUBTFUL = 0.05, 0.01
_FREE = 10.0  # stated uncertainties that a machine which has changed may be off
_ROUNDING = 1e-12
_FEWEST = 8.0  # degrees of freedom by which the noise of a Run is known at the least
_GROWTH = 5e-5  # of a length: steel that is some 4 K warmer
ScaleCause = Literal["wrong-sign", "not-active", "active"]
_Causes = Mapping[float, ScaleCause | None]
_AS_FOUND: _Causes = {1.0: None, 0.0: "active", 2.0: "wrong-sign"}
_BY_FILES: _Causes = {1.0: None, 0.0: "not-active", -1.0: "wrong-sign"}
_NEARLY = 0.2  # of the expected number, whatever the noise


def predict_displacement(
    result: CalibrationResult, at: Conditions, correction: Correction | None = None
) -> Float64[np.ndarray, "n 3"]:
    """Displacement from nominal, by errors of the machine and the controller.

    Lost motion counts by the direction that each axis came from.
    """
    moved = result.model.displacement_mm(at, result.theta)
    moved = moved + compute_lost_motion_mm(result, at)
    moved = moved + compute_second_order_mm(result.model, at, result.theta)
    return moved if correction is None else moved + correction(at)


def estimate_poses(
    result: CalibrationResult,
    parts: Sequence[Observations],
    correction: Correction | None,
) -> Sequence[RunInput]:
    """Pose and noise of each part, whatever its machine is.

    The noise is estimated next to a machine whose errors are free, so that errors of
    the result do not count as noise. The prediction is subtracted first: no noise is
    lost to the free errors either.
    """
    known = extract_prior_effects(
        result.model, np.zeros(result.model.size), result.covariance
    ).inflate_covariance()
    models = build_run_models(
        result.machine, [part.at for part in parts], known.effects
    )
    starts: list[RunInput] = []
    for part in parts:  # less the prediction, with its rough pose
        moved = predict_displacement(result, part.at, correction)
        rest = replace(part, tracker_mm=part.tracker_mm - moved @ part.pose.rotation.T)
        noise = guess_noise(part, perpendicular_only=False)
        starts.append(RunInput(rest, part.pose, noise))
    try:
        return _settle_noise(models.coarse, starts, known)
    except Unidentifiable:  # too few points: typical noise
        return [replace(one, noise=assume_typical_noise(one.noise)) for one in starts]


def _settle_noise(
    model: MachineModel, starts: Sequence[RunInput], known: PriorEffects
) -> Sequence[RunInput]:
    """Alternate between the noise and the variance of the machine's free errors.

    By a noise that is too low, some of it passes for error of the free machine, which
    the next noise then lacks: few points cannot distinguish them, so both are found in
    turn.
    """
    found: Sequence[RunInput] = starts
    for _ in range(_ROUNDS):
        before = [
            replace(start, pose=one.pose, noise=one.noise)
            for start, one in zip(starts, found, strict=True)
        ]
        found = refine_runs(model, before, known=known)
        now, last = (
            [(*one.noise.ou, *one.noise.place) for one in runs]
            for runs in (found, before)
        )
        if np.allclose(now, last, rtol=_SAME_NOISE, atol=0.0):
            break
    return found


@dataclass(frozen=True, slots=True)
class PointVectors:
    """A vector at each point, less rigid motion; covariance : (n, 3, 3) of it"""

    vector_mm: Float64[np.ndarray, "n 3"]
    covariance_mm2: Float64[np.ndarray, "n 3 3"]

    @property
    def length_um(self) -> Float64[np.ndarray, " n"]:
        """Euclidean, µm."""
        return UM_PER_MM * np.linalg.norm(self.vector_mm, axis=1)

    @property
    def length_sigma_um(self) -> Float64[np.ndarray, " n"]:
        """Standard uncertainty of a length: that of the least known direction, µm."""
        largest = np.linalg.eigvalsh(self.covariance_mm2)[:, -1]
        return UM_PER_MM * np.sqrt(np.maximum(largest, 0.0))

    @property
    def sigma_um(self) -> Float64[np.ndarray, "n 3"]:
        """Standard uncertainties of the components, µm."""
        variance = np.diagonal(self.covariance_mm2, axis1=1, axis2=2)
        return UM_PER_MM * np.sqrt(np.maximum(variance, 0.0))


@dataclass(frozen=True, slots=True)
class Consistency:
    """χ² of deviations, and the chance of a larger one if all is as stated.

    The noise is estimated from the Run itself, with the degrees of freedom that a free
    machine leaves: the chance is that of an F distribution.

    share_within : of components that are within their expanded uncertainty (k = 2)
    known_by : degrees of freedom of the noise of the Run
    repeated : chance of the residual of a machine with free errors: small where the
        measurement is inconsistent in itself
    """

    chi_square: float
    freedom: int
    chance: float
    share_within: float
    known_by: float
    repeated: float

    @property
    def is_consistent(self) -> bool:
        """With a chance of 5 % or more by noise and stated uncertainty."""
        return self.chance >= _LIKELY

    @property
    def fits_together(self) -> bool:
        """Whether some machine, changed in any way, would explain the measurement."""
        return self.repeated >= DOUBTFUL


@dataclass(frozen=True)
class MatchedPoints:
    """Measurement and prediction at points, in their m components, mm.

    scale_mm : (m,) by one standard uncertainty of the scale of air and tracker
    tracker_mm : (m, i) by one of each error of a tracker within its specification
    columns : (m, p) of the result's parameters; bend_mm2 : (m,) beyond its tables
    lost_mm : (m, s) by one standard uncertainty of each lost motion that it reports
    change_mm : (m, c) by typical changes of an axis
    less_rigid : (m, m) removes the best-fit pose and seats from components
    """

    result: CalibrationResult
    points: ReducedPoints
    as_found_mm: Float64[np.ndarray, " m"]
    predicted_mm: Float64[np.ndarray, " m"]
    scale_mm: Float64[np.ndarray, " m"]
    tracker_mm: Float64[np.ndarray, "m i"]
    columns: Float64[np.ndarray, "m p"]
    bend_mm2: Float64[np.ndarray, " m"]
    lost_mm: Float64[np.ndarray, "m s"]
    change_mm: Float64[np.ndarray, "m c"]
    less_rigid: Float64[np.ndarray, "m m"]

    @staticmethod
    def of(
        result: CalibrationResult,
        points: ReducedPoints,
        correction: Correction | None,
        errors: Sequence[Effect],
        scale_ppm: float = 0.0,
    ) -> MatchedPoints:
        """Points of one Run with the prediction of a result.

        errors : of the trackers of all Runs, their parameters in standard uncertainties
        scale_ppm : standard uncertainty that all lengths of the Run have in common
        """
        model, at = result.model, points.cells
        as_found = points.project(predict_displacement(result, at))
        predicted = points.project(predict_displacement(result, at, correction))
        reduced = result.reduce_to_targets
        known = estimate_variations(
            reduced.model,
            reduced.theta,
            result.measured or full_travel(result.machine),
            reduced.covariance,
        )
        bend = beyond_travel_variance_mm2(points.at, reduced.model, known)
        size = len(points.owner)
        N = points.nuisance
        turned = [effect.jacobian(at) for effect in errors]
        # The origin does not matter: a shift of all points goes with the pose.
        away_mm = points.project(at.point_mm - at.point_mm.mean(axis=0))
        return MatchedPoints(
            result,
            points,
            as_found,
            predicted,
            PER_PPM * scale_ppm * away_mm,
            np.hstack([np.zeros((size, 0)), *map(points.project, turned)]),
            points.project(model.jacobian(at)),
            np.einsum("mi,mi->m", points.component**2, bend[points.owner]),
            points.project(list_lost_departures_mm(result, at)),
            points.project(_list_typical_changes_mm(at)),
            np.eye(size) - N @ np.linalg.pinv(N, rcond=_ROUNDING),
        )

    @staticmethod
    def join(parts: Sequence[MatchedPoints]) -> MatchedPoints:
        """Several Runs as one, each with its own rigid motion removed."""
        if len(parts) == 1:
            return parts[0]
        return MatchedPoints(
            parts[0].result,
            merge_points([part.points for part in parts]),
            np.concatenate([part.as_found_mm for part in parts]),
            np.concatenate([part.predicted_mm for part in parts]),
            np.concatenate([part.scale_mm for part in parts]),
            np.concatenate([part.tracker_mm for part in parts]),
            np.concatenate([part.columns for part in parts]),
            np.concatenate([part.bend_mm2 for part in parts]),
            np.concatenate([part.lost_mm for part in parts]),
            np.concatenate([part.change_mm for part in parts]),
            block_diag(*(part.less_rigid for part in parts)),
        )

    @property
    def covariance_mm2(self) -> Float64[np.ndarray, "m m"]:
        """Of the measurement: its noise, and the errors that all points share."""
        return self.points.noise_mm2 + self.common_mm @ self.common_mm.T

    @property
    def common_mm(self) -> Float64[np.ndarray, "m c"]:
        """Scale, then errors of the tracker, which all points share."""
        return np.column_stack([self.scale_mm, self.tracker_mm])

    def to_point_vectors(
        self, value: Float64[np.ndarray, " m"], covariance: Float64[np.ndarray, "m m"]
    ) -> PointVectors:
        """A quantity and its covariance as vectors at the points."""
        M = self.less_rigid
        return PointVectors(
            self.points.collect(M @ value),
            self.points.collect_covariance(M @ covariance @ M),
        )

    def predict_covariance(self) -> Float64[np.ndarray, "m m"]:
        """Of the prediction by the result, mm²."""
        spread = self.columns @ self.result.covariance @ self.columns.T
        return spread + self.lost_mm @ self.lost_mm.T + np.diag(self.bend_mm2)

    def covariance_with_free_errors(self) -> Float64[np.ndarray, "m m"]:
        """Of a machine with other errors than the result's, mm²."""
        spread = self.columns @ self.result.covariance @ self.columns.T
        free = _FREE**2 * (spread + self.lost_mm @ self.lost_mm.T)
        return free + self.change_mm @ self.change_mm.T + np.diag(self.bend_mm2)

    def sample(
        self, covariance: Float64[np.ndarray, "m m"], seed: int
    ) -> Float64[np.ndarray, "n 3 d"]:
        """Samples with a covariance, less their rigid motion."""
        value, vector = np.linalg.eigh(covariance)
        unit = np.random.default_rng(seed).standard_normal((len(value), _DRAWS))
        drawn = (vector * np.sqrt(np.maximum(value, 0.0))) @ unit
        return self.points.collect(self.less_rigid @ drawn)

    def compute_chi_square(
        self, covariance: Float64[np.ndarray, "m m"]
    ) -> tuple[float, int]:
        """χ² of the deviations, pose and seats fitted, and its freedom."""
        deviation = self.points.residual_mm - self.predicted_mm
        factor = np.linalg.cholesky(self.covariance_mm2 + covariance)
        whitened = np.linalg.solve(
            factor, np.column_stack([deviation, self.points.nuisance])
        )
        data, taken = whitened[:, 0], _orthonormalise(whitened[:, 1:])
        residual = data - taken @ (taken.T @ data)
        return float(residual @ residual), len(data) - taken.shape[1]

    def fit_scale_factor(
        self, data: Float64[np.ndarray, " m"], shape: Float64[np.ndarray, " m"]
    ) -> tuple[float, float]:
        """Factor of a shape in data, and the inverse variance of it.

        Pose and seats are fitted as well; the noise is that of the measurement.
        """
        factor = np.linalg.cholesky(self.covariance_mm2)
        columns = np.column_stack([data, shape, self.points.nuisance])
        white = np.linalg.solve(factor, columns)
        taken = _orthonormalise(white[:, 2:])
        own = white[:, 1] - taken @ (taken.T @ white[:, 1])
        square = float(own @ own)
        return float(own @ white[:, 0]) / max(square, 1e-300), square

    def match_chi_square(
        self, covariance: Float64[np.ndarray, "m m"], true: Float64[np.ndarray, "m m"]
    ) -> tuple[float, float]:
        """Scale and freedom of the χ² by one covariance where another is true.

        By its first two moments (Satterthwaite 1946), pose and seats removed.
        """
        V = self.covariance_mm2
        ratio = np.linalg.solve(V + covariance, V + true)
        mean = float(np.trace(ratio)) - self.points.nuisance.shape[1]
        square = float(np.sum(ratio * ratio.T))
        mean = max(mean, 1.0)
        scale = square / mean
        return scale, mean / scale


def assess_consistency(
    matched: MatchedPoints, spread: Float64[np.ndarray, "m m"]
) -> Consistency:
    """Test the deviations against the noise and the result's own covariance.

    spread : (m, m) covariance of the prediction, mm²
    """
    chi_square, freedom = matched.compute_chi_square(spread)
    free = matched.covariance_with_free_errors()
    # Prior knowledge of the tracker does not come from the Run.
    tracker = matched.tracker_mm @ matched.tracker_mm.T
    _, noise_freedom = matched.match_chi_square(free, -tracker)
    known_by = max(noise_freedom, _FEWEST)
    rest, _ = matched.compute_chi_square(free)
    scale, rest_freedom = matched.match_chi_square(free, spread)
    M = matched.less_rigid
    off = M @ (matched.points.residual_mm - matched.predicted_mm)
    sigma = np.sqrt(np.diag(M @ (matched.covariance_mm2 + spread) @ M))
    return Consistency(
        chi_square,
        freedom,
        float(fdtrc(freedom, known_by, chi_square / freedom)),
        float(np.mean(np.abs(off) <= K * sigma)),
        known_by,
        float(fdtrc(rest_freedom, known_by, rest / scale / rest_freedom)),
    )


def _orthonormalise(columns: Float64[np.ndarray, "m k"]) -> Float64[np.ndarray, "m r"]:
    unit = columns / np.linalg.norm(columns, axis=0)
    basis, size, _ = np.linalg.svd(unit, full_matrices=False)
    return basis[:, size > 1e-10 * size[0]]


def _list_typical_changes_mm(at: Conditions) -> Float64[np.ndarray, "n 3 c"]:
    # By lost motion, and by growth of linear axes; the origin of growth does not
    # matter: a shift of all points goes with the pose.
    machine = at.machine
    moved: list[Float64[np.ndarray, "n 3"]] = []
    for column, axis in enumerate(machine.axes):
        symbol = f"E{axis.name}{axis.name}"
        arm = compute_arm(symbol, at)
        moved.append(get_typical_size(symbol) * arm * at.approach[:, [column]])
        if axis in machine.linear_axes:
            moved.append(_GROWTH * arm * at.position_mm[:, [column]])
    return np.stack(moved, axis=2)


@dataclass(frozen=True, slots=True)
class MapScale:
    """How much of the result's map the machine still has.

    As found a machine has the errors of the result, so 1 time; an ideal compensation
    leaves 0, one of the wrong sign 2. Files that compensate only a part of the errors
    leave the rest: whether they are active is decided by what they add.

    uncertainty : the standard one; expected : 1 as found, else the residual of the
        files
    cause : why it differs, of the controller's compensation; None where it does not
        differ, or the measurement does not determine it
    """

    value: float
    uncertainty: float
    expected: float
    cause: ScaleCause | None


def estimate_map_scale(
    matched: MatchedPoints, *, is_compensated: bool
) -> MapScale | None:
    """Factor of the map in the measurement; None where the map has no errors.

    is_compensated : the controller is said to correct by files of the result
    """
    value, square = matched.fit_scale_factor(
        matched.points.residual_mm, matched.as_found_mm
    )
    if square < 1.0:
        return None
    expected, _ = matched.fit_scale_factor(matched.predicted_mm, matched.as_found_mm)
    sigma = square**-0.5
    if not is_compensated:
        return MapScale(value, sigma, expected, _find_cause(value, sigma, _AS_FOUND))
    share, square = matched.fit_scale_factor(
        matched.points.residual_mm - matched.as_found_mm,
        matched.predicted_mm - matched.as_found_mm,
    )
    cause = None if square < 1.0 else _find_cause(share, square**-0.5, _BY_FILES)
    return MapScale(value, sigma, expected, cause)


def _find_cause(times: float, sigma: float, causes: _Causes) -> ScaleCause | None:
    clear = 3.0 * sigma + _NEARLY
    near: list[ScaleCause | None] = [
        cause for number, cause in causes.items() if abs(times - number) < clear
    ]
    return near[0] if len(near) == 1 else None
