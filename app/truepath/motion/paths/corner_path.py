"""The path of the 2023 paper, for comparison: lines between corners, and the middle.

Sanders (2023) uses face and space diagonals of the volume, and straight lines at the
start, middle and end of the axes. On lines from corner to corner all axes move in
proportion, so positioning shapes that they share displace the target along the line
only; lines along one axis do not show them across either.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from jaxtyping import Float64

from truepath.kinematics.machine.machine import Machine
from truepath.motion.workspace.travel import DECIMALS, inner_travel
from truepath_drivers.interfaces.records import Path

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
    return np.array([[c & 1, c >> 1 & 1, c >> 2 & 1] for c in tour], np.float64)
