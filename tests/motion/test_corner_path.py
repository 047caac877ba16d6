"""The path of the 2023 paper."""

from itertools import pairwise

import numpy as np
from tests.motion.test_paths import machine

from truepath.motion.paths.corner_path import corner_path


def test_corner_lines_join_corners_or_run_along_one_axis():
    position = corner_path(machine(), 6000.0, 0.4).position
    low, high = position.min(axis=0), position.max(axis=0)
    corner = ((position == low) | (position == high)).all(axis=1)
    between = corner[:-1] & corner[1:]
    one_axis = (np.diff(position, axis=0) != 0.0).sum(axis=1) == 1
    assert (between | one_axis).all()
    ends = {frozenset((a.tobytes(), b.tobytes())) for a, b in pairwise(position)}
    assert sum(between) >= 28
    assert len(ends) >= 28
