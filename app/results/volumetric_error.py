"""The volumetric error over the travel before and after compensation.

Before is the estimated map on a grid. After is what the stated uncertainty leaves where
−δ̂ is applied in full: errors drawn from the covariance of the estimate (JCGM 101).
Both are without the rigid motion of the whole volume. That the machine then does as
promised is for a measurement of its own to show.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.estimation.volumetric_map import build_volumetric_map
from app.files.units import UM_PER_MM
from app.kinematics.conditions import make_standstill
from app.kinematics.machine import Axis, LinearAxis, Machine
from app.kinematics.model import MachineModel

_GRID = 9  # points an axis
_FEW, _FEWEST = 5, 3  # of linear and rotary axes where there are both
_DRAWS = 200  # tell a spread to 5 %
_SHARE = 0.95  # of the places, below the stated quantile
_QUANTILES = 101  # every per cent


@dataclass(frozen=True, slots=True)
class Figure:
    """A number in µm with its standard uncertainty (k = 1)."""

    value_um: float
    uncertainty_um: float


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


def volumetric_error(
    model: MachineModel,
    theta: Float64[np.ndarray, " p"],
    covariance: Float64[np.ndarray, "p p"],
) -> VolumetricError:
    """Return the volumetric error of the first target over the axis travel."""
    position_mm = make_grid(model, _GRID)
    J = UM_PER_MM * build_volumetric_map(model).jacobian(
        make_standstill(model.machine, position_mm)
    )
    error = J @ theta
    drawn = J.reshape(-1, model.size) @ _draw_parameters(covariance)
    left = drawn.reshape(*error.shape, -1)
    return VolumetricError(
        position_mm,
        error,
        np.sqrt(np.einsum("nip,pq,niq->ni", J, covariance, J, optimize=True)),
        np.quantile(np.linalg.norm(left, axis=1), np.linspace(0.0, 1.0, _QUANTILES)),
        _state_before(error, left),
        _state_after(left),
    )


def make_grid(model: MachineModel, points: int) -> Float64[np.ndarray, "n a"]:
    """Return a grid over the travel, ends included, X slowest."""
    turns = bool(model.machine.rotary_axes)
    travel = [
        np.linspace(axis.low, axis.high, _count_points(axis, points, turns=turns))
        for axis in model.machine.axes
    ]
    return np.stack([g.ravel() for g in np.meshgrid(*travel, indexing="ij")], axis=1)


def add_rotary_axes(
    machine: Machine, linear_mm: Float64[np.ndarray, "n 3"]
) -> Float64[np.ndarray, "n a"]:
    """Return positions of all axes, the rotary ones at their zero or nearest to it."""
    rest = [float(np.clip(0.0, a.low, a.high)) for a in machine.rotary_axes]
    return np.hstack([linear_mm, np.tile(rest, (len(linear_mm), 1))])


def _count_points(axis: Axis, points: int, *, turns: bool) -> int:
    """Return the points of an axis; few where five axes span the grid."""
    if not turns:
        return points
    return _FEW if isinstance(axis, LinearAxis) else _FEWEST


def _draw_parameters(
    covariance: Float64[np.ndarray, "p p"],
) -> Float64[np.ndarray, "p d"]:
    value, vector = np.linalg.eigh(covariance)
    unit = np.random.default_rng(0).standard_normal((len(covariance), _DRAWS))
    return vector @ (np.sqrt(np.maximum(value, 0.0))[:, None] * unit)


def _state_before(
    error: Float64[np.ndarray, "n 3"], left: Float64[np.ndarray, "n 3 d"]
) -> Spread:
    value = _measure_lengths(error[:, :, None])[:, 0]
    uncertainty = _measure_lengths(error[:, :, None] + left).std(axis=1)
    return _make_spread(value, uncertainty)


def _state_after(left: Float64[np.ndarray, "n 3 d"]) -> Spread:
    drawn = _measure_lengths(left)
    return _make_spread(drawn.mean(axis=1), drawn.std(axis=1))


def _measure_lengths(error: Float64[np.ndarray, "n 3 d"]) -> Float64[np.ndarray, "3 d"]:
    length = np.linalg.norm(error, axis=1)
    return np.stack(
        [length.mean(axis=0), np.quantile(length, _SHARE, axis=0), length.max(axis=0)]
    )


def _make_spread(
    value: Float64[np.ndarray, "3"], uncertainty: Float64[np.ndarray, "3"]
) -> Spread:
    mean, p95, largest = (
        Figure(float(v), float(u)) for v, u in zip(value, uncertainty, strict=True)
    )
    return Spread(mean, p95, largest)
