"""The volumetric error over the travel before and after compensation.

Before is the estimated map on a grid, the mean of both directions of travel. After is
the residual by the stated uncertainty where −δ̂ is applied in full: errors sampled from
the covariance of the estimate (JCGM 101). Both are without the rigid motion of the
whole volume. Whether the machine then follows the prediction needs a separate
measurement.

The scale of the air is common to all lengths and shows in no residual: it is in the
covariance, and its part of each figure is stated separately. A mean length is least
near the right scale: it grows with the square of the error of the scale. Half the
change at twice the standard uncertainty, the larger of both signs, is therefore stated;
where the statistic is linear in the scale it is the same as that at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from truepath.files.units import PER_PPM, UM_PER_MM
from truepath.kinematics.conditions import Conditions, make_standstill
from truepath.kinematics.machine.machine import Axis, LinearAxis
from truepath.kinematics.model import EstimatedModel
from truepath.kinematics.volumetric_map import VolumetricMap, build_volumetric_map
from truepath.numerics.sobol import compute_sobol_points

_GRID = 9  # points an axis
_FEW, _FEWEST = 5, 3  # of linear and rotary axes where there are both
_DRAWS = 200  # determine a spread to 5 %
_SHARE = 0.95  # of the places, below the stated quantile
_QUANTILES = 101  # every per cent
_EVEN = 2048  # positions that fill the travel
TWICE: tuple[float, float] = (-2.0, 2.0)


@dataclass(frozen=True, slots=True)
class Figure:
    """A number in µm with its standard uncertainty (k = 1).

    scale_uncertainty_um : the part of it that comes from the scale of all lengths
    """

    value_um: float
    uncertainty_um: float
    scale_uncertainty_um: float = 0.0


@dataclass(frozen=True, slots=True)
class Spread:
    """Length of the error over the grid: mean, 95 % of the points, largest."""

    mean: Figure
    p95: Figure
    largest: Figure


@dataclass(frozen=True, slots=True)
class VolumetricError:
    """The volumetric error on a grid over the travel.

    position_mm : (n, axes), X slowest; error_um, uncertainty_um : (n, 3), k = 1
    after_lengths_um : equidistant quantiles, 0 to 100 %, of the expected length after
    """

    position_mm: Float64[np.ndarray, "n a"]
    error_um: Float64[np.ndarray, "n 3"]
    uncertainty_um: Float64[np.ndarray, "n 3"]
    after_lengths_um: Float64[np.ndarray, " q"]
    before: Spread
    after: Spread


@dataclass(frozen=True, slots=True)
class BothDirections:
    """Length of the error where every place is come to in both directions.

    before : with lost motion; left : what tables of the mean of both directions leave,
        so with all of the lost motion
    """

    before: Spread
    left: Spread


def compute_volumetric_error(
    estimated: EstimatedModel, length_scale_ppm: float = 0.0
) -> VolumetricError:
    """Of the first target, on a grid over the axis travel.

    length_scale_ppm : standard uncertainty that all lengths have in common, which the
        covariance contains
    """
    model, covariance = estimated.model, estimated.covariance
    linear = _FEW if model.machine.rotary_axes else _GRID
    position_mm = make_grid(model.machine.axes, linear, _FEWEST)
    volumetric_map, at = (
        build_volumetric_map(model),
        make_standstill(model.machine, position_mm),
    )
    J = UM_PER_MM * volumetric_map.jacobian(at)
    error = J @ estimated.theta
    by_scale = compute_scale_um(volumetric_map, at, length_scale_ppm)[:, :, None]
    drawn = J.reshape(-1, model.size) @ sample_parameters(covariance)
    left = drawn.reshape(*error.shape, -1)
    after = _measure_lengths(left)
    return VolumetricError(
        position_mm,
        error,
        np.sqrt(np.einsum("nip,pq,niq->ni", J, covariance, J, optimize=True)),
        np.quantile(np.linalg.norm(left, axis=1), np.linspace(0.0, 1.0, _QUANTILES)),
        make_spread(
            _measure_lengths(error[:, :, None])[:, 0],
            _measure_lengths(error[:, :, None] + left),
            _measure_lengths(error[:, :, None] + by_scale * TWICE),
        ),
        make_spread(
            after.mean(axis=1),
            after,
            np.stack(
                [_measure_lengths(left + s * by_scale).mean(axis=1) for s in TWICE],
                axis=1,
            ),
        ),
    )


def compute_scale_um(
    volumetric_map: VolumetricMap, at: Conditions, length_scale_ppm: float
) -> Float64[np.ndarray, "n 3"]:
    """Change of the map by one standard uncertainty of the scale.

    The origin does not matter: a shift of all points goes with the rigid motion.
    """
    away_mm = at.point_mm - volumetric_map.centre_mm
    return UM_PER_MM * PER_PPM * length_scale_ppm * away_mm


def make_grid(
    axes: Sequence[Axis], linear: int, rotary: int = 0
) -> Float64[np.ndarray, "n a"]:
    """Grid over the travel, ends included, the first axis slowest.

    linear, rotary : points of an axis
    """
    travel = [
        np.linspace(a.low, a.high, linear if isinstance(a, LinearAxis) else rotary)
        for a in axes
    ]
    return np.stack([g.ravel() for g in np.meshgrid(*travel, indexing="ij")], axis=1)


def sample_travel_evenly(
    axes: Sequence[Axis], count: int
) -> Float64[np.ndarray, "n a"]:
    """Quasi-random positions (Sobol), evenly distributed; the same in every call."""
    low, high = (np.array([getattr(a, end) for a in axes]) for end in ("low", "high"))
    unit = compute_sobol_points(len(axes), count)
    return low + unit * (high - low)


def sample_parameters(
    covariance: Float64[np.ndarray, "p p"],
) -> Float64[np.ndarray, "p d"]:
    """Samples of the parameters' errors by their covariance, the same in every call."""
    value, vector = np.linalg.eigh(covariance)
    unit = np.random.default_rng(0).standard_normal((len(covariance), _DRAWS))
    # By the symmetric root: eigenvectors of one eigenvalue are any of many, by chance.
    return (vector * np.sqrt(np.maximum(value, 0.0))) @ (vector.T @ unit)


def _measure_lengths(error: Float64[np.ndarray, "n 3 d"]) -> Float64[np.ndarray, "3 d"]:
    length = np.linalg.norm(error, axis=1)
    return np.stack(
        [length.mean(axis=0), np.quantile(length, _SHARE, axis=0), length.max(axis=0)]
    )


def make_spread(
    value: Float64[np.ndarray, "3"],
    drawn: Float64[np.ndarray, "3 d"],
    at_twice: Float64[np.ndarray, "3 2"],
) -> Spread:
    """Mean, 95 % and largest, with the spread of the samples.

    at_twice : the same with all lengths off by `TWICE` the uncertainty of their scale
    """
    by_scale = compute_scale_uncertainty(value, at_twice)
    # A mean length grows with the square of the scale: twice its spread is too little.
    total = np.maximum(drawn.std(axis=1), by_scale)
    return Spread(*map(Figure, value.tolist(), total.tolist(), by_scale.tolist()))


def compute_both_directions(
    estimated: EstimatedModel, length_scale_ppm: float = 0.0
) -> BothDirections | None:
    """Length of the error over both directions; None without lost motion.

    Mean and 95 % are over positions evenly distributed in the travel, as in the record
    of compensation files; the largest is that on a grid with the corners too.

    length_scale_ppm : standard uncertainty that all lengths have in common, which the
        covariance contains
    """
    model = estimated.model
    lost = np.zeros(model.size)
    for effect in model.effects:
        if effect.half_difference:
            lost[model.slices[effect.name]] = 1.0
    if not lost.any():
        return None
    even, grid = (
        sample_travel_evenly(model.machine.axes, _EVEN),
        make_grid(model.machine.axes, _FEW, _FEWEST),
    )
    at = make_standstill(model.machine, np.vstack([even, grid]))
    volumetric_map = build_volumetric_map(model)
    drawn = sample_parameters(estimated.covariance)
    by_scale = compute_scale_um(volumetric_map, at, length_scale_ppm)
    J = [
        volumetric_map.jacobian(replace(at, approach=np.full_like(at.approach, side)))
        for side in (1.0, -1.0)  # + and − direction
    ]

    def spread(mean: Float64[np.ndarray, " p"], *, expected: bool = False) -> Spread:
        theta = np.column_stack([mean, mean[:, None] + drawn])
        lengths = [_list_lengths(UM_PER_MM * one, theta, by_scale) for one in J]
        inside = np.vstack([one[: len(even)] for one in lengths])
        stated = np.stack(
            [
                inside.mean(axis=0),
                np.quantile(inside, _SHARE, axis=0),
                np.vstack(lengths).max(axis=0),
            ]
        )
        value, each = stated[:, 0], stated[:, 1:-2]
        value = each.mean(axis=1) if expected else value
        return make_spread(value, each, stated[:, -2:])

    left = spread(lost * estimated.theta, expected=True)
    return BothDirections(spread(estimated.theta), left)


def _list_lengths(
    J: Float64[np.ndarray, "n 3 p"],
    theta: Float64[np.ndarray, "p d"],
    by_scale: Float64[np.ndarray, "n 3"],
) -> Float64[np.ndarray, "n e"]:
    """By each parameters, and by the first with the scale off to either side."""
    error = (J.reshape(-1, len(theta)) @ theta).reshape(len(J), 3, -1)
    scaled = [error[:, :, 0] + times * by_scale for times in TWICE]
    every = np.concatenate([error, np.stack(scaled, axis=2)], axis=2)
    return np.linalg.norm(every, axis=1)


def compute_scale_uncertainty(
    value: Float64[np.ndarray, " m"], at_twice: Float64[np.ndarray, "m 2"]
) -> Float64[np.ndarray, " m"]:
    """Standard uncertainty of statistics by the scale of their lengths.

    at_twice : the same with all lengths off by `TWICE` its standard uncertainty
    """
    return 0.5 * np.max(np.abs(at_twice - value[:, None]), axis=1)
