"""Plans are driven part by part, and what is driven again comes between."""

import numpy as np

from truepath.motion.configurations import Configurations
from truepath.motion.paths.planned_rows import PlannedRows
from truepath_drivers.interfaces.records import Path


def path(rows=8):
    position = np.arange(rows, dtype=float)[:, None] * np.ones(3)
    return Path(("X", "Y", "Z"), position, np.full(rows, 6000.0), np.zeros(rows))


def drive(planned):
    while planned.next() is not None:
        pass
    return planned.driven.position[:, 0].tolist()


def test_the_parts_are_the_whole_plan_and_nothing_else():
    planned = PlannedRows(path())
    assert planned.total == 7
    assert len(planned.driven) < 8
    assert drive(planned) == list(range(8))


def test_what_is_driven_again_comes_before_the_rest_and_counts():
    planned = PlannedRows(path())
    planned.next()
    planned.repeat(3)
    assert drive(planned) == [0, 1, 2, 3, 4, 3, 2, 3, 4, 5, 6, 7]
    assert planned.total == 11


def test_nobody_drives_farther_back_than_six_lines():
    planned = PlannedRows(path(20))
    for _ in range(6):
        planned.next()
    planned.repeat(0)
    assert planned.next().position[:, 0].min() == 8.0


def test_the_last_lines_are_driven_again_after_all_others():
    planned = PlannedRows(path(3))
    planned.repeat(2)
    assert drive(planned) == [0, 1, 2, 1, 2]


def test_a_measurement_ends_however_often_lines_are_asked_for():
    planned = PlannedRows(path())
    for _ in range(40):
        planned.repeat(1)
        if planned.next() is None:
            break
    assert planned.next() is None
    assert planned.driven.position[-1, 0] == 7.0


def test_points_are_measured_again_in_their_order():
    position = np.arange(5.0)[:, None] * np.ones(3)
    planned = PlannedRows(Configurations(("X", "Y", "Z"), position, np.ones(5)))
    planned.next()
    planned.repeat(3)
    assert drive(planned) == [0, 1, 2, 3, 3, 4]


def test_points_behind_a_box_are_gone_back_to_by_the_ways_that_were_driven():
    position = np.arange(5.0)[:, None] * np.ones(3)
    points = Configurations(("X", "Y", "Z"), position, np.ones(5))
    planned = PlannedRows(points, lambda *_: False)
    planned.next()
    planned.repeat(1)
    assert drive(planned) == [0, 1, 2, 3, 2, 1, 2, 3, 4]
    assert planned.total == 5 + 4
