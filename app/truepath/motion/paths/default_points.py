"""Points and lines without a plan: default standstill points, the 2023 paper's path.

They need no estimator and no time: the service makes them while it answers.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from jaxtyping import Float64

from truepath.errors import PlanningError
from truepath.kinematics.machine.machine import Machine
from truepath.motion.configurations import Configurations
from truepath.motion.motion_times import find_short_order
from truepath.motion.workspace import DECIMALS, inner_travel, moving_targets
from truepath_drivers.interfaces.records import Path

DEFAULT_POINTS = 60  # some four minutes on a small mill
POINTS_WITH_ROTARY_AXES = 180  # fewer leave motions of five axes to the prior
_DWELL_S = 1.0
_LEAST_TURN_DEG = 10.0  # or a tenth of the travel
_REPEATED = 4  # points, from the same side but the first: the pose of a rigid body


def default_points(machine: Machine, *, count: int | None = None) -> Configurations:
    """Standstill points: the eight corners, the rest spread evenly inside.

    They are in an order of short moves, and are always the same. Where there are rotary
    axes, the points are spread over all axes and over the targets. Of several, the
    first is measured again at the end, partly at its first points.

    count : None for 60, or 180 with rotary axes
    """
    turning = bool(machine.rotary_axes)
    count = count or (POINTS_WITH_ROTARY_AXES if turning else DEFAULT_POINTS)
    if count < 8:
        raise PlanningError(f"{count} points: it must be 8 points or more")
    rng, target = np.random.default_rng(0), ()
    if turning:
        names = [t.name for t in moving_targets(machine)]
        again = _REPEATED if len(names) > 1 else 0
        position = _turn_all_axes(machine, count, rng, again)
        if any(names):
            # Half of the first target's points at the end: a shift in between shows.
            own = np.arange(count) * len(names) // count
            target = tuple(names[k] for k in np.roll(own, -np.sum(own == 0) // 2))
    else:
        position = _spread(machine, count, rng)
    return Configurations(
        machine.axis_names, position, np.full(count, _DWELL_S), target
    )


def _spread(
    machine: Machine, count: int, rng: np.random.Generator
) -> Float64[np.ndarray, "n a"]:
    """Corners, then a Latin hypercube: a point in each slice of each axis."""
    low, high = inner_travel(machine)
    inside = count - 8
    slices = np.stack([rng.permutation(inside) for _ in range(3)], axis=1)
    unit = np.vstack(
        [unit_corners(), (slices + rng.random((inside, 3))) / max(inside, 1)]
    )
    points = np.round(low + unit * (high - low), DECIMALS)
    apart = np.linalg.norm(points[:, None] - points, axis=2)
    return points[find_short_order(apart)]


def _turn_all_axes(
    machine: Machine, count: int, rng: np.random.Generator, again: int
) -> Float64[np.ndarray, "n a"]:
    """Random points inside the travel, some first ones again at the end.

    From one to the next every rotary axis turns, so that a target on the table moves
    and its standstills are distinguishable.
    """
    low, high = inner_travel(machine)
    travel = min(axis.high - axis.low for axis in machine.rotary_axes)
    least_turn_deg = min(_LEAST_TURN_DEG, 0.1 * travel)
    places = [rng.uniform(low, high)]
    while len(places) < count - again:
        place = rng.uniform(low, high)
        is_last = len(places) + 1 == count - again
        near = np.array([places[-1], places[0] if is_last else places[-1]])
        turn = np.abs(place - near)[:, len(machine.linear_axes) :]
        if turn.min() > least_turn_deg:
            places.append(place)
    return np.round([*places, *places[:again]], DECIMALS)


def unit_corners() -> Float64[np.ndarray, "8 3"]:
    """X changes fastest."""
    return np.array([[i & 1, i >> 1 & 1, i >> 2 & 1] for i in range(8)], float)


# Through the middle of the volume along each axis, reached parallel to the axes.
_MIDDLE = np.array(
    [
        [0.0, 0.5, 1.0],
        [0.0, 0.5, 0.5],
        [1.0, 0.5, 0.5],
        [0.5, 0.5, 0.5],
        [0.5, 0.0, 0.5],
        [0.5, 1.0, 0.5],
        [0.5, 0.5, 0.5],
        [0.5, 0.5, 0.0],
        [0.5, 0.5, 1.0],
    ]
)


def corner_path(machine: Machine, feed_mm_min: float, dwell_s: float) -> Path:
    """All 28 lines between corners, then the three through the middle.

    Rotary axes are at 0, or at the near end of their travel. Seven lines meet in each
    corner, an odd number, so some are repeated.
    """
    low, high = inner_travel(machine)
    unit = np.vstack([_tour(), _MIDDLE])
    position = np.tile(np.clip(0.0, low, high), (len(unit), 1))
    linear = len(machine.linear_axes)
    position[:, :linear] = low[:linear] + unit * (high[:linear] - low[:linear])
    n = len(position)
    return Path(
        machine.axis_names,
        np.round(position, DECIMALS).astype(np.float64),
        np.full(n, feed_mm_min),
        np.full(n, dwell_s),
    )


def _tour() -> Float64[np.ndarray, "s 3"]:
    left = set(combinations(range(8), 2))
    tour = [0]
    while left:
        here = tour[-1]
        ahead = [c for c in range(8) if tuple(sorted((here, c))) in left]
        if ahead:
            # To the corner with most lines left, so that the tour rarely gets stuck.
            corner = max(ahead, key=lambda c: sum(c in pair for pair in left))
        else:
            corner = min(left)[0]
        left.discard((min(here, corner), max(here, corner)))
        tour.append(corner)
    return unit_corners()[tour]
