"""Positions at which an export is judged: on rows of its tables and between them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from app.compensation.error_map import ErrorMap

GRID, RANDOM = 5, 400  # positions an axis of the grid; random positions


def sample_positions(errors: ErrorMap) -> Float64[np.ndarray, "n a"]:
    """Return a grid over the travel, and random positions between rows."""
    low = np.array([axis.min_mm for axis in errors.axes])
    high = np.array([axis.max_mm for axis in errors.axes])
    unit = np.stack(
        np.meshgrid(*[np.linspace(0.0, 1.0, GRID)] * len(low), indexing="ij"), -1
    ).reshape(-1, len(low))
    random = np.random.default_rng(0).random((RANDOM, len(low)))
    position = np.tile(errors.middle_mm, (len(unit) + RANDOM, 1))
    position[:, : len(low)] = low + np.vstack([unit, random]) * (high - low)
    return position


def remove_rigid_motion(
    position_mm: Float64[np.ndarray, "n a"], error_mm: Float64[np.ndarray, "n 3"]
) -> Float64[np.ndarray, "n 3"]:
    """Remove the best-fit rigid motion, which is not an error of the machine."""
    point = position_mm[:, :3] - position_mm[:, :3].mean(axis=0)
    columns = np.zeros((len(point), 3, 6))
    columns[:, :, :3] = np.eye(3)
    for k, axis in enumerate(np.eye(3)):
        columns[:, :, 3 + k] = np.cross(axis, point)
    flat = columns.reshape(-1, 6)
    fit, *_ = np.linalg.lstsq(flat, error_mm.reshape(-1), rcond=None)
    return error_mm - (flat @ fit).reshape(-1, 3)
