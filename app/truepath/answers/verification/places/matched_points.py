"""Measurement and prediction at the same points, both less their rigid motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.linalg import block_diag
from scipy.special import fdtrc

from truepath.answers.verification.places.length_statistics import DRAWS
from truepath.answers.verification.places.predicted_motion import (
    Correction,
    predict_displacement,
)
from truepath.answers.verification.places.reduced_points import (
    ReducedPoints,
    merge_points,
)
from truepath.estimation.solve.extrapolation import (
    beyond_travel_variance_mm2,
    estimate_variations,
    full_travel,
)
from truepath.files.earlier.result_file import CalibrationResult
from truepath.files.units import PER_PPM, UM_PER_MM
from truepath.kinematics.conditions import Conditions
from truepath.kinematics.effects.base import Effect
from truepath.kinematics.effects.error_motion import compute_arm, get_typical_size
from truepath.results.lost_motion import list_lost_departures_mm

K = 2.0
# Chances below which deviations are not consistent, and a measurement is in doubt.
_LIKELY, DOUBTFUL = 0.05, 0.01
_FREE = 10.0  # stated uncertainties that a machine which has changed may be off
_ROUNDING = 1e-12
_FEWEST = 8.0  # degrees of freedom by which the noise of a Run is known at the least
_GROWTH = 5e-5  # of a length: steel that is some 4 K warmer


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
    lost_mm : (m, s) by one standard uncertainty of each lost motion that it states
    change_mm : (m, c) by typical changes of an axis
    less_rigid : (m, m) removes the best-fit pose and seats from components
    """

    result: CalibrationResult
    places: ReducedPoints
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
        places: ReducedPoints,
        correction: Correction | None,
        errors: Sequence[Effect],
        scale_ppm: float = 0.0,
    ) -> MatchedPoints:
        """Points of one Run with the prediction of a result.

        errors : of the trackers of all Runs, their parameters in standard uncertainties
        scale_ppm : standard uncertainty that all lengths of the Run have in common
        """
        model, at = result.model, places.cells
        as_found = places.project(predict_displacement(result, at))
        predicted = places.project(predict_displacement(result, at, correction))
        told = result.reduce_to_targets
        known = estimate_variations(
            told.model,
            told.theta,
            result.measured or full_travel(result.machine),
            told.covariance,
        )
        bend = beyond_travel_variance_mm2(places.at, told.model, known)
        size = len(places.owner)
        N = places.nuisance
        turned = [effect.jacobian(at) for effect in errors]
        # The origin does not matter: a shift of all points goes with the pose.
        away_mm = places.project(at.point_mm - at.point_mm.mean(axis=0))
        return MatchedPoints(
            result,
            places,
            as_found,
            predicted,
            PER_PPM * scale_ppm * away_mm,
            np.hstack([np.zeros((size, 0)), *map(places.project, turned)]),
            places.project(model.jacobian(at)),
            np.einsum("mi,mi->m", places.component**2, bend[places.owner]),
            places.project(list_lost_departures_mm(result, at)),
            places.project(_list_typical_changes_mm(at)),
            np.eye(size) - N @ np.linalg.pinv(N, rcond=_ROUNDING),
        )

    @staticmethod
    def join(parts: Sequence[MatchedPoints]) -> MatchedPoints:
        """Several Runs as one, each with its own rigid motion removed."""
        if len(parts) == 1:
            return parts[0]
        return MatchedPoints(
            parts[0].result,
            merge_points([part.places for part in parts]),
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
        return self.places.noise_mm2 + self.common_mm @ self.common_mm.T

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
            self.places.collect(M @ value),
            self.places.collect_covariance(M @ covariance @ M),
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

    def draw(
        self, covariance: Float64[np.ndarray, "m m"], seed: int
    ) -> Float64[np.ndarray, "n 3 d"]:
        """Samples with a covariance, less their rigid motion."""
        value, vector = np.linalg.eigh(covariance)
        unit = np.random.default_rng(seed).standard_normal((len(value), DRAWS))
        drawn = (vector * np.sqrt(np.maximum(value, 0.0))) @ unit
        return self.places.collect(self.less_rigid @ drawn)

    def compute_chi_square(
        self, covariance: Float64[np.ndarray, "m m"]
    ) -> tuple[float, int]:
        """χ² of the deviations, pose and seats fitted, and its freedom."""
        deviation = self.places.residual_mm - self.predicted_mm
        factor = np.linalg.cholesky(self.covariance_mm2 + covariance)
        whitened = np.linalg.solve(
            factor, np.column_stack([deviation, self.places.nuisance])
        )
        data, taken = whitened[:, 0], _orthonormalise(whitened[:, 1:])
        left = data - taken @ (taken.T @ data)
        return float(left @ left), len(data) - taken.shape[1]

    def fit_scale_factor(
        self, data: Float64[np.ndarray, " m"], shape: Float64[np.ndarray, " m"]
    ) -> tuple[float, float]:
        """Factor of a shape in data, and the inverse variance of it.

        Pose and seats are fitted as well; the noise is that of the measurement.
        """
        factor = np.linalg.cholesky(self.covariance_mm2)
        columns = np.column_stack([data, shape, self.places.nuisance])
        white = np.linalg.solve(factor, columns)
        taken = _orthonormalise(white[:, 2:])
        own = white[:, 1] - taken @ (taken.T @ white[:, 1])
        square = float(own @ own)
        return float(own @ white[:, 0]) / max(square, 1e-300), square

    def match_chi_square(
        self,
        covariance: Float64[np.ndarray, "m m"],
        true: Float64[np.ndarray, "m m"],
    ) -> tuple[float, float]:
        """Scale and freedom of the χ² by one covariance where another is true.

        By its first two moments (Satterthwaite 1946), pose and seats removed.
        """
        V = self.covariance_mm2
        ratio = np.linalg.solve(V + covariance, V + true)
        mean = float(np.trace(ratio)) - self.places.nuisance.shape[1]
        square = float(np.sum(ratio * ratio.T))
        mean = max(mean, 1.0)
        scale = square / mean
        return scale, mean / scale


def assess_consistency(
    held: MatchedPoints, spread: Float64[np.ndarray, "m m"]
) -> Consistency:
    """Test the deviations against the noise and the result's own covariance.

    spread : (m, m) covariance of the prediction, mm²
    """
    chi_square, freedom = held.compute_chi_square(spread)
    free = held.covariance_with_free_errors()
    # Prior knowledge of the tracker does not come from the Run.
    tracker = held.tracker_mm @ held.tracker_mm.T
    _, noise_freedom = held.match_chi_square(free, -tracker)
    known_by = max(noise_freedom, _FEWEST)
    rest, _ = held.compute_chi_square(free)
    scale, rest_freedom = held.match_chi_square(free, spread)
    M = held.less_rigid
    off = M @ (held.places.residual_mm - held.predicted_mm)
    sigma = np.sqrt(np.diag(M @ (held.covariance_mm2 + spread) @ M))
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
