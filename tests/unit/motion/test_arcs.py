"""Arcs of a path: where they reach, how long they take, as files, and driven again."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from paths_by_hand import path_of
from truepath.errors import BundleError, OutOfTravel, PlanningError
from truepath.files.bundle import commanded_file
from truepath.motion.configurations import append_part
from truepath.motion.motion_times import row_times_s
from truepath.motion.nc_programs.programs import write_program
from truepath.motion.paths.plan_segments import drive_again, drive_arcs_again
from truepath.motion.paths.verification_points import TURN_DEG, make_circle_path
from truepath.motion.workspace import Box, Workspace, check_travel
from truepath_drivers.cnc.travel import arrange_path, check_arcs
from truepath_drivers.interfaces import arcs, errors
from truepath_drivers.interfaces.records import Arc, Path


@pytest.fixture(scope="module")
def circles(mill):
    return make_circle_path(mill)


def test_circles_stay_in_the_travel_and_take_the_time_of_their_way(mill, circles):
    check_travel(mill, circles)
    turning = row_times_s(circles)[[arc is not None for arc in circles.arc]]
    radius_mm = 0.4 * 384.0  # of the travel of Y less its margins
    one_s = np.radians(TURN_DEG) * radius_mm / 50.0
    assert turning[:2] == pytest.approx([one_s + 1.0] * 2, abs=0.2)


def test_an_arc_out_of_the_travel_or_into_a_box_is_refused_by_its_row(mill):
    # Half a turn of 100 mm radius, far beyond what its ends span.
    ends, arc = ((100, 50, -50), (300, 50, -50)), Arc("XY", (200.0, 50.0), 180.0)
    half_turn = path_of(*ends, feed=3000.0, dwell_s=1.0, arc=(None, arc))
    with pytest.raises(OutOfTravel, match="row 2: Y = -50 mm is below 0 mm"):
        check_travel(mill, half_turn)
    turned = replace(half_turn, arc=(None, replace(arc, turn_deg=-180.0)))
    check_travel(mill, turned)
    box = Box((195.0, -60.0, -60.0), (205.0, -40.0, -40.0))
    with pytest.raises(PlanningError, match="the way to row 2 enters the keep-out box"):
        Workspace(keep_out=(box,)).require_allowed(mill, half_turn)
    places, row = arcs.trace(half_turn)
    assert np.array_equal(places[-1], half_turn.position[-1])
    assert set(row.tolist()) == {0, 1}


def test_arcs_survive_their_files_unless_they_do_not_lead_to_their_row(mill, circles):
    data = commanded_file.encode_commanded(circles)
    json = commanded_file.encode_commanded_json(circles)
    rows = commanded_file.decode_commanded(data, mill, "path.csv", is_path=True)
    for again in (rows, commanded_file.decode_commanded_json(json)):
        assert isinstance(again, Path)
        assert again.arc == circles.arc
        assert np.array_equal(again.position, circles.position)
    text = data.decode().replace(",732.0", ",720.0", 1)
    with pytest.raises(BundleError, match=r"row 4.*from where its arc leads to"):
        commanded_file.decode_commanded(text.encode(), mill, "path.csv", is_path=True)


def test_a_circle_is_driven_back_and_forth_when_it_is_driven_again_and_again(circles):
    whole = append_part(circles, drive_again(circles, 3))
    added = whole.arc[len(circles) :]
    back = [None if a is None else replace(a, turn_deg=-a.turn_deg) for a in added]
    half = len(added) // 2
    assert list(added[half:]) == back[:half][::-1]
    assert list(added[half:]) == list(circles.arc[3:])
    once = append_part(circles, drive_arcs_again(circles, {2}))
    (row,) = [k for k in range(len(circles), len(once)) if once.arc[k]]
    twice = drive_arcs_again(once, {row})
    assert len(twice) == 3
    assert twice.arc[1:] == (replace(circles.arc[2], turn_deg=-732.0), circles.arc[2])


@pytest.mark.parametrize("broken", [{2}, {3}, {2, 3}, {2, 11}, {6}])
def test_a_broken_circle_is_driven_again_whole_and_no_other_one(mill, circles, broken):
    part = drive_arcs_again(circles, broken)
    check_travel(mill, part)
    whole = append_part(circles, part)
    arrange_path(whole, circles.axes, drives_arcs=True)
    travel = [(axis.low, axis.high) for axis in mill.axes]
    check_arcs(part, travel)
    again = [(row, arc) for row, arc in enumerate(part.arc) if arc]
    # Each of them from where it began to where it ended, in its sense and at its feed.
    for row in broken:
        begin, end = circles.position[row - 1 : row + 1]
        assert any(
            arc == circles.arc[row]
            and np.array_equal(part.position[k - 1 : k + 1], [begin, end])
            and part.feed_mm_min[k] == circles.feed_mm_min[row]
            for k, arc in again
        )
    planes = {circles.arc[row].axes for row in broken}
    assert {arc.axes for _, arc in again} == planes
    assert len(again) <= 2 * len(planes)
    # Straight lines are those that were driven.
    driven = [{tuple(a), tuple(b)} for a, b in pairwise(circles.position.tolist())]
    for k in range(1, len(part)):
        ends = [tuple(at) for at in part.position[k - 1 : k + 1].tolist()]
        assert part.arc[k] or set(ends) in driven


def test_what_drives_no_arcs_says_so(mill, circles):
    with pytest.raises(errors.Refused, match="arcs, which this control does not offer"):
        arrange_path(circles, circles.axes, drives_arcs=False)
    with pytest.raises(PlanningError, match="arcs"):
        write_program(circles, mill, "linuxcnc")
