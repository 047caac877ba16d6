"""Standstill points when nobody has planned better ones, travel times, travel checks.

The points need no estimator and no time: the service makes them while it answers.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from app.errors import OutOfTravel, PlanningError
from app.kinematics.machine import Machine
from app.motion.configurations import Configurations
from app.motion.motion_times import moving_s
from app.motion.short_order import find_short_order
from app.motion.travel import DECIMALS, first_breach, inner_travel
from app.motion.turning_points import turning_points
from drivers.interfaces.records import Path

DEFAULT_FEED_MM_MIN = 6000.0
DEFAULT_POINTS = 60  # some four minutes on a small mill
POINTS_WITH_ROTARY_AXES = 180  # fewer leave motions of five axes to the prior
ACCELERATION_MM_S2 = 1000.0  # of a usual machine; times are predicted with it


def default_points(
    machine: Machine,
    *,
    count: int | None = None,
    dwell_s: float = 1.0,
    seed: int = 0,
) -> Configurations:
    """Return standstill points: the eight corners, the rest spread evenly inside.

    They stand in an order of short moves. The same seed gives the same points. Where
    there are rotary axes, the points are spread over all axes and over the targets.

    count : 60 where it is left out, 180 with rotary axes
    """
    turning = bool(machine.rotary_axes)
    count = count or (POINTS_WITH_ROTARY_AXES if turning else DEFAULT_POINTS)
    if count < 8 or dwell_s <= 0:
        raise PlanningError(
            f"{count} points, dwell {dwell_s:g} s: 8 points or more, a dwell above 0"
        )
    if turning:
        return turning_points(machine, count=count, dwell_s=dwell_s, seed=seed)
    low, high = inner_travel(machine)
    corners = low + unit_corners() * (high - low)
    inside = _spread(np.random.default_rng(seed), count - 8)
    points = np.round(np.concatenate([corners, low + inside * (high - low)]), DECIMALS)
    apart = np.linalg.norm(points[:, None] - points, axis=2)
    position = points[find_short_order(apart)]
    return Configurations(machine.axis_names, position, np.full(count, dwell_s))


def line_times_s(path: Path) -> Float64[np.ndarray, " n"]:
    """Return the time of each row: the line towards it, exact stops, and its dwell.

    The first row counts its dwell alone. The feed is that of the linear axes; where
    none moves it is that of the rotary axes, in deg/min (formats.md), with the same
    figure for their acceleration in deg/s².
    """
    linear = np.array([name in "XYZ" for name in path.axes])
    step = np.diff(path.position, axis=0)
    straight = np.asarray(np.linalg.norm(step[:, linear], axis=1), np.float64)
    turn = np.asarray(np.linalg.norm(step[:, ~linear], axis=1), np.float64)
    length = np.where(straight > 0, straight, turn)
    moving = moving_s(length, path.feed_mm_min[1:], ACCELERATION_MM_S2)
    return np.concatenate([[0.0], moving]) + path.dwell_s


def travel_time_s(path: Path) -> float:
    """Return how long the path takes from its first row, dwells included."""
    return float(line_times_s(path).sum())


def check_travel(machine: Machine, commanded: Path | Configurations) -> None:
    """Raise OutOfTravel if a row lies beyond the travel or moves an unknown axis.

    Rows are counted from 1. To be called before a plan reaches the machine.
    """
    for name in commanded.axes:
        if name not in machine.axis_names:
            raise OutOfTravel(
                f"the plan moves axis {name}, which {machine.name} does not have; "
                f"its axes are {', '.join(machine.axis_names)}"
            )
    if not np.isfinite(commanded.position).all():
        row, column = np.argwhere(~np.isfinite(commanded.position))[0]
        raise OutOfTravel(
            f"row {row + 1}: {commanded.axes[column]} is not a finite number; "
            "correct the row"
        )
    breach = first_breach(machine, commanded)
    if breach is not None:
        raise OutOfTravel(
            f"row {breach.index + 1}: {breach}; "
            "shorten the plan or correct the travel in the machine file"
        )


def unit_corners() -> Float64[np.ndarray, "8 3"]:
    """Return the corners of the unit cube."""
    return np.array([[i & 1, i >> 1 & 1, i >> 2 & 1] for i in range(8)], float)


def _spread(rng: np.random.Generator, count: int) -> Float64[np.ndarray, "n 3"]:
    """Draw a Latin hypercube: each of `count` slices of each axis holds one point."""
    slices = np.stack([rng.permutation(count) for _ in range(3)], axis=1)
    return (slices + rng.random((count, 3))) / max(count, 1)
