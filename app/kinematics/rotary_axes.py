"""Rotations of rotary axes: about which line, by how much, in which directions.

An axis on the workpiece side turns the workpiece by its angle, so what is seen from the
workpiece turns back; one on the tool side turns the tool. Symbols of a rotary axis name
its local directions: those of the machine, turned the shortest way that brings the
letter's own direction (A: X, B: Y, C: Z) onto the direction of the axis.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from jaxtyping import Float64

from app.kinematics.machine import RotaryAxis
from app.kinematics.symbols import TURNS


def compute_turns(
    axis: RotaryAxis, angle_rad: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, "n 3 3"]:
    """Return the right-handed turns about the direction of the axis (Rodrigues)."""
    K = _across(np.array(axis.direction))
    sine, cosine = np.sin(angle_rad)[:, None, None], np.cos(angle_rad)[:, None, None]
    return np.eye(3) + sine * K + (1.0 - cosine) * (K @ K)


@lru_cache(maxsize=64)
def find_local_directions(axis: RotaryAxis) -> Float64[np.ndarray, "3 3"]:
    """Return the directions that X, Y, Z in its symbols mean, as columns."""
    own = np.eye(3)[TURNS.index(axis.name)]
    direction = np.array(axis.direction)
    cosine = float(own @ direction)
    if cosine < -1.0 + 1e-12:  # half a turn, about the next direction
        other = np.eye(3)[(TURNS.index(axis.name) + 1) % 3]
        return 2.0 * np.outer(other, other) - np.eye(3)
    K = _across(np.cross(own, direction))
    return np.eye(3) + K + K @ K / (1.0 + cosine)


def _across(v: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3 3"]:
    """Return K with K p = v × p."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
