"""Default points, travel times and the travel check."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from truepath.errors import OutOfTravel, PlanningError
from truepath.kinematics.machine.machine import (
    LinearAxis,
    Machine,
    MotionLimits,
    RotaryAxis,
    Target,
)
from truepath.kinematics.machine.tracker_noise import TrackerNoise
from truepath.motion.configurations import Configurations
from truepath.motion.motion_times import row_times_s, travel_time_s
from truepath.motion.paths.commanded_rows import command_rows
from truepath.motion.paths.default_points import default_points
from truepath.motion.paths.feeds import check_feed
from truepath.motion.workspace.travel import check_travel
from truepath_drivers.interfaces.records import Path


def machine(x: float = 500.0, y: float = 400.0, z: float = 300.0) -> Machine:
    return Machine(
        "small mill",
        ("X",),
        ("Y", "Z"),
        (LinearAxis("X", 0.0, x), LinearAxis("Y", 0.0, y), LinearAxis("Z", -z, 0.0)),
        (Target("", "tool", (20.0, 30.0, -150.0)),),
        TrackerNoise(),
    )


def with_table() -> Machine:
    plain = machine()
    table = RotaryAxis("C", 10.0, 350.0, (0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    return replace(
        plain, axes=(*plain.axes, table), workpiece_side=("C", *plain.workpiece_side)
    )


def line(*rows: tuple[float, float, float], feed: float = 6000.0) -> Path:
    n = len(rows)
    return Path(("X", "Y", "Z"), np.array(rows), np.full(n, feed), np.zeros(n))


def test_points_turn_every_rotary_axis_and_measure_every_target():
    on_base = replace(TrackerNoise(), stands_on="base")
    targets = (
        Target("T", "tool", (20.0, 30.0, -150.0)),
        Target("W", "workpiece", (150.0, 0.0, 0.0)),
    )
    mill = replace(with_table(), targets=targets, tracker=on_base)
    points = default_points(mill)
    assert len(points) == 180
    assert np.abs(np.diff(points.position[:, 3])).min() > 9.9
    assert np.ptp(points.position[:, 3]) > 300.0
    assert set(points.target) == {"T", "W"}
    check_travel(mill, points)
    np.testing.assert_array_equal(points.position, default_points(mill).position)


def test_default_points_hold_the_corners_and_fill_the_inside():
    points = default_points(machine(), count=40)
    assert len(points) == 40
    check_travel(machine(), points)
    assert len(np.unique(points.position, axis=0)) == 40
    low, high = points.position.min(axis=0), points.position.max(axis=0)
    corner = ((points.position == low) | (points.position == high)).all(axis=1)
    assert corner.sum() == 8
    share = (points.position[~corner] - low) / (high - low)
    for column in range(3):
        counts, _ = np.histogram(share[:, column], bins=4, range=(0, 1))
        assert counts.min() == counts.max() == 8


def test_default_points_lie_in_an_order_of_short_moves():
    points = default_points(machine())
    moves = np.linalg.norm(np.diff(points.position, axis=0), axis=1).sum()
    shuffled = np.random.default_rng(0).permutation(points.position)
    assert moves < 0.6 * np.linalg.norm(np.diff(shuffled, axis=0), axis=1).sum()


def test_too_few_points_are_refused():
    with pytest.raises(PlanningError, match="8 points or more"):
        default_points(machine(), count=7)


def test_travel_time_counts_lines_stops_and_dwells():
    path = line((0, 0, 0), (100, 0, 0), (100, 100, 0))
    path = replace(path, dwell_s=np.array([1.0, 2.0, 3.0]))
    # 100 mm at 100 mm/s and 1000 mm/s²: 1.0 s and 0.1 s for the two ramps.
    assert travel_time_s(path) == pytest.approx(6.0 + 2.2)
    np.testing.assert_allclose(row_times_s(path), [1.0, 3.1, 4.1])


def test_a_line_too_short_for_its_feed_takes_its_two_ramps():
    path = line((0, 0, 0), (4, 0, 0))
    assert travel_time_s(path) == pytest.approx(2 * (4 / 1000) ** 0.5)


def test_a_rotary_move_is_timed_by_its_degrees():
    path = Path(
        ("X", "Y", "Z", "C"),
        np.array([[0.0, 0, 0, 0], [0.0, 0, 0, 90]]),
        np.full(2, 1800.0),
        np.zeros(2),
    )
    assert travel_time_s(path) == pytest.approx(90 / 30 + 30 / 1000)


@pytest.mark.fault_row(24)
def test_a_position_out_of_travel_is_refused_with_row_axis_value_and_remedy(measured):
    with pytest.raises(OutOfTravel) as caught:
        check_travel(machine(), line((0, 0, 0), (612.4, 0, 0)))
    text = str(caught.value)
    assert text.startswith("row 2: X = 612.4 mm exceeds 500 mm; ")
    assert "shorten the plan" in text
    measured(f"“{text}”")


@pytest.mark.parametrize("feed_mm_min", [1e-9, 0.99, 8001.0, 1e6])
def test_a_feed_that_cannot_be_driven_is_refused_with_its_row(feed_mm_min):
    mill = replace(machine(), motion=MotionLimits(8000.0, assumed=()))
    rows = [{"x_mm": x, "y_mm": 0, "z_mm": 0} for x in (0, 100)]
    rows[1]["feed_mm_min"] = feed_mm_min
    with pytest.raises(PlanningError, match=r"row 2: a feed of .* give 1 to 8000 mm"):
        command_rows(mill, rows, is_path=True)
    with pytest.raises(PlanningError, match="cannot be driven by small mill"):
        check_feed(mill, feed_mm_min)
    rows[1]["feed_mm_min"] = 8000.0
    assert command_rows(mill, rows, is_path=True).feed_mm_min[1] == 8000.0


def test_a_position_below_the_travel_is_refused():
    with pytest.raises(OutOfTravel, match=r"row 1: Z = -301 mm is below -300 mm"):
        check_travel(machine(), line((0, 0, -301), (0, 0, 0)))


def test_an_angle_out_of_travel_is_refused_in_degrees():
    points = Configurations(
        ("X", "Y", "Z", "C"), np.array([[0.0, 0.0, 0.0, 355.0]]), np.ones(1)
    )
    with pytest.raises(OutOfTravel, match=r"C = 355 deg exceeds 350 deg"):
        check_travel(with_table(), points)


def test_an_axis_that_the_machine_lacks_is_refused_by_name():
    points = Configurations(("X", "Y", "Z", "A"), np.zeros((1, 4)), np.ones(1))
    with pytest.raises(OutOfTravel, match=r"axis A.*its axes are X, Y, Z"):
        check_travel(machine(), points)


def test_a_position_that_is_not_finite_is_refused():
    with pytest.raises(OutOfTravel, match=r"row 2: Y is not a finite number"):
        check_travel(machine(), line((0, 0, 0), (1, np.nan, 0)))


def test_the_rounding_of_a_file_is_not_out_of_travel():
    check_travel(machine(x=499.99996), line((0, 0, 0), (500.0, 0, 0)))
