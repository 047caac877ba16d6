"""A path of several targets is cut where the target changes, and loses no line."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from truepath.motion.paths.by_target import cut_by_target
from truepath_drivers.interfaces.records import Path


def make_path(*target: str) -> Path:
    n = 6
    position = np.arange(3.0 * n).reshape(n, 3)
    return Path(
        ("X", "Y", "Z"), position, np.arange(100.0, 100.0 + n), np.zeros(n), target
    )


def test_each_stretch_begins_where_the_one_before_has_ended():
    path = make_path("T1", "T1", "T1", "T2", "T2", "T1")
    stretches = cut_by_target(path)
    assert [stretch.row for stretch in stretches] == [0, 2, 4]
    assert [stretch.path.target for stretch in stretches] == [
        ("T1",) * 3,
        ("T2",) * 3,
        ("T1",) * 2,
    ]
    driven = np.concatenate([stretch.path.feed_mm_min[1:] for stretch in stretches])
    np.testing.assert_array_equal(driven, path.feed_mm_min[1:])
    for before, after in pairwise(stretches):
        np.testing.assert_array_equal(before.path.position[-1], after.path.position[0])


def test_a_path_of_one_target_stays_as_it_is():
    for path in (make_path(), make_path(*["T1"] * 6)):
        (stretch,) = cut_by_target(path)
        assert stretch.row == 0
        assert stretch.path.target == path.target
        np.testing.assert_array_equal(stretch.path.position, path.position)
