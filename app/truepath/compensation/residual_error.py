"""Error that remains with the files of a format, as their controller reads them.

It is computed on a grid and between the rows of the tables.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64

from truepath.compensation.format import Correction
from truepath.compensation.tables.error_map import ErrorMap, MeasuredRange, find_own_arm
from truepath.files.earlier.result_file import CalibrationResult
from truepath.files.units import UM_PER_MM
from truepath.kinematics.conditions import make_standstill
from truepath.numerics.rigid import cross_matrix
from truepath.results.lost_motion import sample_across_mm
from truepath.results.volumetric_error import (
    make_grid,
    sample_parameters,
    sample_travel_evenly,
)

GRID, EVEN = 5, 512  # positions an axis of the grid; those that fill the travel
CLOSE = 4096  # that fill it for the mean of the map, whose own error is below its U
_FEWEST = 12  # positions for a mean in addition to their rigid motion
# Of a standard deviation whose number of values a file does not state: 50 values.
_UNSTATED_SCALE = 0.1
SIDES = (1.0, -1.0)  # + and − direction
COVERAGE = 2.0  # k of expanded uncertainties


def sample_travel(
    errors: ErrorMap, count: int = EVEN
) -> tuple[Float64[np.ndarray, "n a"], Float64[np.ndarray, " n"]]:
    """Positions over the travel and their weights in a mean; the weights sum to 1.

    Positions with a weight fill the travel evenly, between the rows of the tables; a
    grid with the corners, where errors are largest, counts for the largest alone.
    """
    grid = make_grid(errors.axes, GRID)
    position = np.tile(errors.middle_mm, (len(grid) + count, 1))
    position[:, : len(errors.axes)] = [*grid, *sample_travel_evenly(errors.axes, count)]
    return position, np.append(np.zeros(len(grid)), np.full(count, 1.0 / count))


def remove_rigid_motion(
    position_mm: Float64[np.ndarray, "n a"],
    error_mm: Float64[np.ndarray, "n 3 ..."],
    weight: Float64[np.ndarray, " n"] | None = None,
) -> Float64[np.ndarray, "n 3 ..."]:
    """Subtract the best-fit rigid motion, which is not an error of the machine.

    error_mm : of one map, or of many along the last axes
    """
    root = np.sqrt(np.ones(len(position_mm)) if weight is None else weight)
    point = position_mm[:, :3] - position_mm[:, :3].mean(axis=0)
    shifts = np.broadcast_to(np.eye(3), (len(point), 3, 3))
    columns = np.concatenate([shifts, cross_matrix(point)], axis=2).reshape(-1, 6)
    rows, root = error_mm.reshape(len(columns), -1), np.repeat(root, 3)[:, None]
    fit, *_ = np.linalg.lstsq(root * columns, root * rows, rcond=None)
    return error_mm - (columns @ fit).reshape(error_mm.shape)


@dataclass(frozen=True, slots=True)
class ResidualError:
    """Remaining errors at positions over the travel, both directions, in mm.

    position_mm : (n, 3 or more), of the linear axes or the tool, others after these
    left_mm : (s, n, 3) of the map with the correction, without rigid motion
    drawn_mm : (s, n, 3, d) errors of the map, sampled from its covariance
    is_measured : (n,) where every axis was measured
    weight : (n,) of each position in a mean
    scale : relative standard uncertainty of the size of the samples
    close : the map alone at positions so close that its mean is that of the travel;
        None where these are
    """

    position_mm: Float64[np.ndarray, "n a"]
    left_mm: Float64[np.ndarray, "s n 3"]
    drawn_mm: Float64[np.ndarray, "s n 3 d"]
    is_measured: Bool[np.ndarray, " n"]
    weight: Float64[np.ndarray, " n"]
    scale: float
    close: ResidualError | None = None

    def summarise_map(self, *, measured: bool = False) -> dict[str, float]:
        """Mean and largest length of the map itself, µm.

        measured : only at positions where every axis was measured, if there are enough;
            their own rigid motion is removed
        """
        if measured and (part := self.select_measured()) is not None:
            return part.summarise_map()
        every = UM_PER_MM * np.linalg.norm(self.left_mm, axis=2)
        mean = (self.close or self).average_map_um()
        return {"mean": mean, "largest": float(every.max())}

    def summarise(self, *, measured: bool = False) -> dict[str, float] | None:
        """Mean length, largest length and standard uncertainty of the mean, µm.

        As `summarise_map`, of errors the measurement allows; None if there are too few
        measured positions.
        """
        if measured:
            part = self.select_measured()
            return None if part is None else part.summarise()
        mean, largest = self._sample_lengths_um()
        of_map = self.average_map_um()
        expected, sigma = expect_length(mean, of_map, self.scale)
        return {
            "mean": expected + self.summarise_map()["mean"] - of_map,
            "largest": float(largest.mean()),
            "mean_uncertainty": sigma,
        }

    def compute_map_uncertainty_um(self) -> float:
        """Standard uncertainty of the mean length of the map, µm.

        Unknown errors make the map longer than the error is. The excess is not
        subtracted but counts as an uncertainty.
        """
        mean, _ = self._sample_lengths_um()
        return float(np.hypot(mean.std(), mean.mean() - self.average_map_um()))

    def compute_difference_um(self, other: ResidualError) -> float:
        """Root mean square length of the difference of two corrections, µm."""
        return self._average_um((self.left_mm - other.left_mm) ** 2)

    @property
    def rms_um(self) -> float:
        """Root mean square length of the remaining map, µm."""
        return self._average_um(self.left_mm**2)

    @property
    def unknown_um(self) -> float:
        """Root mean square length of the sampled errors, µm."""
        return self._average_um(np.mean(self.drawn_mm**2, axis=3))

    def average_map_um(self) -> float:
        """Mean length of the map at these positions, µm."""
        every = UM_PER_MM * np.linalg.norm(self.left_mm, axis=2)
        return float(np.average(every.mean(axis=0), weights=self.weight))

    def select_measured(self) -> ResidualError | None:
        """Part at positions where every axis was measured; None if they are too few.

        The rigid motion of unmeasured errors is no part of it.
        """
        kept = self.is_measured
        weight = self.weight[kept]
        if np.count_nonzero(weight) < _FEWEST:
            return None
        position = self.position_mm[kept]
        left, drawn = (
            remove_common_rigid_motion(position, list(errors[:, kept]), weight)
            for errors in (self.left_mm, self.drawn_mm)
        )
        return replace(
            self,
            position_mm=position,
            left_mm=left,
            drawn_mm=drawn,
            is_measured=kept[kept],
            weight=weight / weight.sum(),
            close=self.close and self.close.select_measured(),
        )

    def _sample_lengths_um(
        self,
    ) -> tuple[Float64[np.ndarray, " d"], Float64[np.ndarray, " d"]]:
        """Mean and largest length of each sample."""
        total = self.left_mm[..., None] + self.drawn_mm
        lengths = UM_PER_MM * np.linalg.norm(total, axis=2)
        mean = np.average(lengths.mean(axis=0), axis=0, weights=self.weight)
        return mean, lengths.max(axis=(0, 1))

    def _average_um(self, squares_mm2: Float64[np.ndarray, "k n 3"]) -> float:
        each = squares_mm2.sum(axis=2).mean(axis=0)
        return UM_PER_MM * float(np.sqrt(self.weight @ each))


def expect_length(
    drawn: Float64[np.ndarray, " d"], of_map: float, scale: float
) -> tuple[float, float]:
    """Expected remaining length, and its standard uncertainty.

    drawn : sampled lengths of errors that the measurement allows; of_map : that of the
        map
    scale : relative standard uncertainty of the size of the samples

    The uncertainty combines the spread of the samples and the uncertainty of their
    size.
    """
    mean = float(drawn.mean())
    return mean, float(np.hypot(drawn.std(), scale * (mean - of_map)))


def compute_residual_error(
    errors: ErrorMap,
    measured: Mapping[str, MeasuredRange],
    correction: Correction | None = None,
) -> ResidualError:
    """Remaining error with a correction, or without any."""
    position, weight = sample_travel(errors)
    close, even = sample_travel(errors, CLOSE)
    scale = find_scale(errors.result)
    return ResidualError(
        position,
        _compute_residual_mm(errors, correction, position, weight),
        sample_errors_mm(errors, position),
        _find_measured(errors, measured, position),
        weight,
        scale,
        ResidualError(
            close,
            _compute_residual_mm(errors, correction, close, even),
            np.zeros((len(SIDES), len(close), 3, 0)),
            _find_measured(errors, measured, close),
            even,
            scale,
        ),
    )


def _compute_residual_mm(
    errors: ErrorMap,
    correction: Correction | None,
    position: Float64[np.ndarray, "n a"],
    weight: Float64[np.ndarray, " n"],
) -> Float64[np.ndarray, "s n 3"]:
    """Without one rigid motion of both directions: lost motion between them stays."""
    left: list[Float64[np.ndarray, "n 3"]] = []
    for side in SIDES:
        error = errors.error_mm(position, side)
        if correction is not None:
            error = error + correction(position, side)
        left.append(error)
    return remove_common_rigid_motion(position, left, weight)


def _find_measured(
    errors: ErrorMap,
    measured: Mapping[str, MeasuredRange],
    position: Float64[np.ndarray, "n a"],
) -> Bool[np.ndarray, " n"]:
    inside = [
        (position[:, column] >= one.low) & (position[:, column] <= one.high)
        for column, one in enumerate(measured[axis.name] for axis in errors.axes)
    ]
    return np.all(inside, axis=0)


def find_scale(result: CalibrationResult) -> float:
    """Relative uncertainty of a standard deviation of ν values, 1/√(2ν).

    ν is the number of independent values of the slow noise in the measurement, which
    dominates the uncertainty of the errors (JCGM 100, E.4.3).
    """
    if result.noise_freedom is None:
        return _UNSTATED_SCALE
    return float(1.0 / np.sqrt(2.0 * result.noise_freedom))


def sample_errors_mm(
    errors: ErrorMap, position: Float64[np.ndarray, "n a"]
) -> Float64[np.ndarray, "s n 3 d"]:
    """Sampled errors of the map in both directions, lost motion included."""
    at = make_standstill(errors.machine, position)
    J = errors.volumetric_map.jacobian(at).reshape(3 * len(position), -1)
    drawn = (J @ sample_parameters(errors.result.covariance)).reshape(
        len(position), 3, -1
    )
    both = np.stack([drawn] * len(SIDES))
    rng = np.random.default_rng(1)
    both += sample_across_mm(errors.result, at, drawn.shape[2])
    for column, axis in enumerate(errors.axes):
        sigma = errors.half_difference_sigma(axis.name, position[:, column])
        half = np.outer(sigma, rng.standard_normal(drawn.shape[2]))
        moved = find_own_arm(axis, at)[:, :, None] * half[:, None]
        for number, side in enumerate(SIDES):
            both[number] += side * moved
    return both


def remove_common_rigid_motion(
    position: Float64[np.ndarray, "n a"],
    error_mm: Sequence[Float64[np.ndarray, "n 3 ..."]],
    weight: Float64[np.ndarray, " n"],
) -> Float64[np.ndarray, "s n 3 ..."]:
    """Errors of each direction without their common rigid motion."""
    every = remove_rigid_motion(
        np.concatenate([position] * len(error_mm)),
        np.concatenate(error_mm),
        np.concatenate([weight] * len(error_mm)),
    )
    return every.reshape(len(error_mm), *error_mm[0].shape)
