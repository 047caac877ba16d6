"""Driving again what was driven: back along the same lines, then forth."""

import numpy as np

from truepath.motion.configurations import Configurations, append_part
from truepath.motion.paths.driven_again import drive_again
from truepath_drivers.interfaces.records import Path


def test_lines_are_driven_back_and_forth_each_at_its_own_feed(square):
    feeds = np.array([6000.0, 1000.0, 2000.0, 3000.0])
    path = Path(square.axes, square.position, feeds, square.dwell_s)
    whole = append_part(path, drive_again(path, 2))
    again = whole.position[3:]
    assert np.array_equal(again, path.position[[3, 2, 1, 2, 3]])
    assert whole.feed_mm_min[4:].tolist() == [3000.0, 2000.0, 2000.0, 3000.0]


def test_points_are_measured_again_in_their_order(square):
    points = Configurations(square.axes, square.position, square.dwell_s)
    assert np.array_equal(drive_again(points, 2).position, points.position[2:])


def test_points_behind_a_box_are_gone_back_to_by_the_ways_that_were_driven(square):
    points = Configurations(square.axes, square.position, square.dwell_s)
    asked = []

    def is_free(begin, end):
        asked.append((begin.tolist(), end.tolist()))
        return False

    again = drive_again(points, 1, is_free)
    assert np.array_equal(again.position, points.position[[2, 1, 2, 3]])
    assert asked == [(points.position[3].tolist(), points.position[1].tolist())]
