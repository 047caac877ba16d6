"""Paths, points and arcs: order, times, limits of travel; driven again and as files."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from paths_by_hand import path_of
from truepath.errors import BadInput, BundleError, OutOfTravel, PlanningError
from truepath.files.bundle import commanded_file
from truepath.kinematics.machine.machine import LinearAxis, MotionLimits, RotaryAxis
from truepath.measurement.engine.path_steps import cut_by_target
from truepath.motion.configurations import Configurations, append_part
from truepath.motion.motion_times import find_short_order, row_times_s, travel_time_s
from truepath.motion.nc_programs.programs import write_program
from truepath.motion.paths import verification_points
from truepath.motion.paths.commanded_rows import check_feed, command_rows
from truepath.motion.paths.default_points import corner_path, default_points
from truepath.motion.paths.plan_segments import drive_again, drive_arcs_again
from truepath.motion.paths.verification_kinds import VerificationKind
from truepath.motion.paths.verification_points import TURN_DEG, make_circle_path
from truepath.motion.workspace import Box, Workspace, check_travel
from truepath_drivers.cnc.travel import arrange_path, check_arcs
from truepath_drivers.interfaces import arcs, errors
from truepath_drivers.interfaces.records import Arc, Path


@pytest.fixture
def with_table(mill):
    table = RotaryAxis("C", 10.0, 350.0, (0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    axes, side = (*mill.axes, table), ("C", *mill.workpiece_side)
    return replace(mill, axes=axes, workpiece_side=side)


def test_points_turn_every_rotary_axis_and_measure_every_target(with_table, trunnion):
    machine = replace(with_table, targets=trunnion.targets, tracker=trunnion.tracker)
    points = default_points(machine)
    assert len(points) == 180
    assert np.abs(np.diff(points.position[:, 3])).min() > 9.9
    assert np.ptp(points.position[:, 3]) > 300.0
    assert set(points.target) == {"T", "W"}
    check_travel(machine, points)
    np.testing.assert_array_equal(points.position, default_points(machine).position)


def test_a_rotary_axis_of_little_travel_turns_a_tenth_of_it_from_point_to_point(mill):
    head = RotaryAxis("B", -6.0, 6.0, (0.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    axes, side = (*mill.axes, head), (*mill.tool_side, "B")
    points = default_points(replace(mill, axes=axes, tool_side=side))
    assert np.abs(np.diff(points.position[:, 3])).min() > 1.19


def test_default_points_hold_the_corners_and_fill_the_inside_in_short_moves(mill):
    points = default_points(mill, count=40)
    assert len(points) == 40
    check_travel(mill, points)
    assert len(np.unique(points.position, axis=0)) == 40
    low, high = points.position.min(axis=0), points.position.max(axis=0)
    corner = ((points.position == low) | (points.position == high)).all(axis=1)
    assert corner.sum() == 8
    share = (points.position[~corner] - low) / (high - low)
    for column in range(3):
        counts, _ = np.histogram(share[:, column], bins=4, range=(0, 1))
        assert counts.min() == counts.max() == 8
    points = default_points(mill)
    moves = np.linalg.norm(np.diff(points.position, axis=0), axis=1).sum()
    shuffled = np.random.default_rng(0).permutation(points.position)
    assert moves < 0.6 * np.linalg.norm(np.diff(shuffled, axis=0), axis=1).sum()
    with pytest.raises(PlanningError, match="8 points or more"):
        default_points(mill, count=7)


def test_corner_lines_join_corners_or_run_along_one_axis(mill):
    """The path of the 2023 paper."""
    position = corner_path(mill, 6000.0, 0.4).position
    low, high = position.min(axis=0), position.max(axis=0)
    corner = ((position == low) | (position == high)).all(axis=1)
    between = corner[:-1] & corner[1:]
    one_axis = (np.diff(position, axis=0) != 0.0).sum(axis=1) == 1
    assert (between | one_axis).all()
    ends = {frozenset((a.tobytes(), b.tobytes())) for a, b in pairwise(position)}
    assert sum(between) >= 28
    assert len(ends) >= 28


def test_travel_time_counts_lines_stops_and_dwells():
    path = path_of((0, 0, 0), (100, 0, 0), (100, 100, 0), dwell_s=(1.0, 2.0, 3.0))
    # 100 mm at 100 mm/s and 1000 mm/s²: 1.0 s and 0.1 s for the two ramps.
    assert travel_time_s(path) == pytest.approx(6.0 + 2.2)
    np.testing.assert_allclose(row_times_s(path), [1.0, 3.1, 4.1])
    # A line too short for its feed takes its two ramps; turning counts in degrees.
    short = path_of((0, 0, 0), (4, 0, 0))
    assert travel_time_s(short) == pytest.approx(2 * (4 / 1000) ** 0.5)
    turn = path_of((0, 0, 0, 0), (0, 0, 0, 90), axes="XYZC", feed=1800.0)
    assert travel_time_s(turn) == pytest.approx(90 / 30 + 30 / 1000)


def test_a_short_order_has_no_stretch_that_is_better_turned_round(rng):
    at = rng.uniform(size=(40, 2))
    time_s = np.linalg.norm(at[:, None] - at, axis=2)
    order = find_short_order(time_s)
    assert (order[0], sorted(order)) == (0, list(range(40)))
    length = time_s[order[:-1], order[1:]].sum()
    assert length < 0.45 * time_s[np.arange(39), np.arange(1, 40)].sum()
    for i in range(1, 40):
        for j in range(i + 1, 41):
            turned = np.r_[order[:i], order[i:j][::-1], order[j:]]
            assert time_s[turned[:-1], turned[1:]].sum() > length - 1e-9


@pytest.mark.fault_row(24)
def test_a_position_out_of_travel_is_refused_with_row_axis_value_and_remedy(
    mill, measured
):
    """The rounding of a file is none."""
    axes = (LinearAxis("X", 0.0, 499.99996), *mill.axes[1:])
    check_travel(replace(mill, axes=axes), path_of((0, 0, 0), (500.0, 0, 0)))
    with pytest.raises(OutOfTravel) as caught:
        check_travel(mill, path_of((0, 0, 0), (612.4, 0, 0)))
    text = str(caught.value)
    assert text.startswith("row 2: X = 612.4 mm exceeds 500 mm; ")
    assert "shorten the plan" in text
    measured(f"“{text}”")


def test_a_feed_that_cannot_be_driven_is_refused_with_its_row(mill):
    mill = replace(mill, motion=MotionLimits(8000.0, assumed=()))
    rows = [{"x_mm": x, "y_mm": 0, "z_mm": 0} for x in (0, 100)]
    for feed_mm_min in (1e-9, 0.99, 8001.0, 1e6):
        rows[1]["feed_mm_min"] = feed_mm_min
        with pytest.raises(PlanningError, match=r"row 2: a feed of .* give 1 to 8000"):
            command_rows(mill, rows, is_path=True)
        with pytest.raises(PlanningError, match="cannot be driven by small mill"):
            check_feed(mill, feed_mm_min)
    rows[1]["feed_mm_min"] = 8000.0
    assert command_rows(mill, rows, is_path=True).feed_mm_min[1] == 8000.0


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        (path_of((0, 0, -301), (0, 0, 0)), r"row 1: Z = -301 mm is below -300 mm"),
        (path_of((0, 0, 0), (1, np.nan, 0)), r"row 2: Y is not a finite number"),
        (path_of((0, 0, 0, 355), axes="XYZC"), r"C = 355 deg exceeds 350 deg"),
        (path_of((0, 0, 0, 0), axes="XYZA"), r"axis A.*its axes are X, Y, Z, C"),
    ],
)
def test_what_is_out_of_travel_is_refused_by_row_axis_and_unit(with_table, rows, said):
    points = Configurations(rows.axes, rows.position, rows.dwell_s)
    for commanded in (rows, points):
        with pytest.raises(OutOfTravel, match=said):
            check_travel(with_table, commanded)


def test_each_stretch_of_a_target_begins_where_the_one_before_has_ended():
    names = ("T1", "T1", "T1", "T2", "T2", "T1")
    rows, feeds = np.arange(18.0).reshape(6, 3), np.arange(100.0, 106.0)
    path = path_of(*rows, feed=feeds, target=names)
    stretches = cut_by_target(path)
    assert [stretch.row for stretch in stretches] == [0, 2, 4]
    targets = [stretch.path.target for stretch in stretches]
    assert targets == [("T1",) * 3, ("T2",) * 3, ("T1",) * 2]
    driven = np.concatenate([stretch.path.feed_mm_min[1:] for stretch in stretches])
    np.testing.assert_array_equal(driven, path.feed_mm_min[1:])
    for before, after in pairwise(stretches):
        np.testing.assert_array_equal(before.path.position[-1], after.path.position[0])
    for whole in (replace(path, target=()), replace(path, target=("T1",) * 6)):
        (stretch,) = cut_by_target(whole)
        assert (stretch.row, stretch.path.target) == (0, whole.target)
        np.testing.assert_array_equal(stretch.path.position, whole.position)


def test_lines_and_points_are_driven_again_as_they_were_around_a_box(square):
    feeds = np.array([6000.0, 1000.0, 2000.0, 3000.0])
    path = replace(square, feed_mm_min=feeds)
    whole = append_part(path, drive_again(path, 2))
    assert np.array_equal(whole.position[3:], path.position[[3, 2, 1, 2, 3]])
    assert whole.feed_mm_min[4:].tolist() == [3000.0, 2000.0, 2000.0, 3000.0]
    points = Configurations(square.axes, square.position, square.dwell_s)
    assert np.array_equal(drive_again(points, 2).position, points.position[2:])
    asked = []

    def is_free(begin, end):
        asked.append((begin.tolist(), end.tolist()))
        return False

    again = drive_again(points, 1, is_free)
    assert np.array_equal(again.position, points.position[[2, 1, 2, 3]])
    assert asked == [(points.position[3].tolist(), points.position[1].tolist())]


def test_verification_points_stay_in_the_travel_and_are_not_mixed_with_circles(mill):
    for kind in VerificationKind:
        points = verification_points.make_verification_rows(mill, [kind], 3)
        check_travel(mill, points)
        minutes = float(row_times_s(points, 10_000.0, mill.motion).sum()) / 60.0
        assert minutes < 8.0
    with pytest.raises(BadInput, match="ask for each by itself"):
        verification_points.make_verification_rows(mill, list(VerificationKind), 1)


def test_between_circles_in_motion_the_path_stands_at_six_corners_once_each(mill):
    path = make_circle_path(mill)
    low, high = path.position.min(axis=0), path.position.max(axis=0)
    at_corner = ((path.position == low) | (path.position == high)).all(axis=1)
    assert at_corner.sum() == len(np.unique(path.position[at_corner], axis=0)) == 6


def make_points(mill, kind, seed=1, *workspace):
    return verification_points.make_verification_points(mill, [kind], seed, *workspace)


def test_random_points_are_those_of_their_seed_and_keep_clear_of_boxes(mill):
    kind = VerificationKind.RANDOM_POINTS
    first, again, other = (make_points(mill, kind, seed).position for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 1.0
    low, high = np.array([(axis.low, axis.high) for axis in mill.axes]).T
    middle, size = (low + high) / 2, (high - low) / 4
    vice = Box(tuple(middle - size), tuple(middle + size), "vice")
    workspace = Workspace(keep_out=(vice,))
    for seed in range(5):
        points = make_points(mill, kind, seed, workspace)
        assert points.position.shape == (verification_points.RANDOM_POINTS, 3)
        workspace.require_allowed(mill, points)
    full = Workspace(keep_out=(Box(tuple(low), tuple(high)),))
    with pytest.raises(PlanningError, match="leaves room for 0 of 30 random points"):
        make_points(mill, kind, 1, full)


def test_targets_are_come_to_five_times_from_both_sides_and_four_diagonals_driven(mill):
    points = make_points(mill, VerificationKind.BIDIRECTIONAL)
    step = np.diff(points.position, axis=0)
    for column in range(3):
        alone = (np.abs(np.delete(step, column, axis=1)) < 1e-9).all(axis=1)
        moves = alone & (np.abs(step[:, column]) > 0.0)
        target = points.position[1:][moves, column]
        up = step[moves, column] > 0.0
        both = [
            (int((up & (target == one)).sum()), int((~up & (target == one)).sum()))
            for one in np.unique(target)
        ]
        assert len([pair for pair in both if pair == (5, 5)]) >= 5
    points = make_points(mill, VerificationKind.DIAGONALS)
    low, high = points.position.min(axis=0), points.position.max(axis=0)
    at_corner = ((points.position == low) | (points.position == high)).all(axis=1)
    assert len(np.unique(points.position[at_corner], axis=0)) == 8


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
