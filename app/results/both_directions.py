"""The volumetric error over both directions of travel, where lost motion is known.

The map is the mean of both directions. A machine that comes to a place from the other
side stands elsewhere by twice the half difference: here every place counts once for
each direction, all axes coming up, then all coming down. The rigid motion that both
have in common is no error of the machine.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float64
from scipy.stats import qmc

from truepath.app.files.units import UM_PER_MM
from truepath.app.kinematics.conditions import make_standstill
from truepath.app.kinematics.estimated_model import EstimatedModel
from truepath.app.kinematics.machine import Machine
from truepath.app.kinematics.volumetric_map import build_volumetric_map
from truepath.app.results.length_scale import TWICE
from truepath.app.results.volumetric_error import (
    Spread,
    draw_parameters,
    find_scale_um,
    make_grid,
    make_spread,
)

EVEN, GRID, FEWEST = 2048, 5, 3  # positions; grid points of linear and rotary axes
_SIDES = (1.0, -1.0)  # + and − direction
_SHARE = 0.95  # of the places, below the stated quantile


def compute_both_directions(
    estimated: EstimatedModel, length_scale_ppm: float = 0.0
) -> Spread | None:
    """Return length of the error over both directions; None without lost motion.

    Mean and 95 % are over positions that fill the travel evenly, as in the account of
    compensation files; the largest is that on a grid with the corners too.

    length_scale_ppm : standard uncertainty that all measured lengths have in common
    """
    model = estimated.model
    if not any(effect.half_difference for effect in model.effects):
        return None
    even, grid = fill_travel(model.machine), make_grid(model.machine, GRID, FEWEST)
    at = make_standstill(model.machine, np.vstack([even, grid]))
    volumetric_map = build_volumetric_map(model)
    theta = estimated.theta[:, None] + draw_parameters(estimated.covariance)
    theta = np.column_stack([estimated.theta, theta])
    by_scale = find_scale_um(volumetric_map, at, length_scale_ppm)
    lengths: list[Float64[np.ndarray, "n d"]] = []
    for side in _SIDES:
        coming = replace(at, approach=np.full_like(at.approach, side))
        J = UM_PER_MM * volumetric_map.jacobian(coming).reshape(-1, model.size)
        error = (J @ theta).reshape(len(at), 3, -1)
        scaled = [error[:, :, 0] + times * by_scale for times in TWICE]
        every = np.concatenate([error, np.stack(scaled, axis=2)], axis=2)
        lengths.append(np.linalg.norm(every, axis=1))
    inside = np.vstack([one[: len(even)] for one in lengths])
    stated = np.stack(
        [
            inside.mean(axis=0),
            np.quantile(inside, _SHARE, axis=0),
            np.vstack(lengths).max(axis=0),
        ]
    )
    return make_spread(stated[:, 0], stated[:, 1:-2], stated[:, -2:])


def fill_travel(machine: Machine) -> Float64[np.ndarray, "n a"]:
    """Return positions that fill the travel of all axes evenly."""
    low = np.array([axis.low for axis in machine.axes])
    high = np.array([axis.high for axis in machine.axes])
    unit = qmc.Sobol(len(low), rng=np.random.default_rng(0)).random(EVEN)
    return low + unit * (high - low)
