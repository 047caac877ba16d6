"""Planned on-the-fly paths of machines with rotary axes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.errors import PlanningError
from app.kinematics.conditions import standstill
from app.kinematics.machine import (
    LinearAxis,
    Machine,
    RotaryAxis,
    Target,
    TrackerNoise,
)
from app.motion.paths import check_travel, travel_time_s
from app.planning.default_path import default_path
from app.planning.turning_information import (
    nothing_known_of_turning,
    slopes_mm,
    turning_conditions,
    turning_rows,
)
from app.planning.turning_lines import FASTEST_DEG_MIN
from drivers.interfaces.records import Path

TARGETS = (
    Target("T1", "tool", (0.0, 0.0, -150.0)),
    Target("T2", "tool", (60.0, 0.0, -80.0)),
    Target("W1", "workpiece", (390.0, 225.0, -150.0)),
)
SIX_TARGETS = (
    *TARGETS[:2],
    Target("T3", "tool", (0.0, 70.0, -110.0)),
    TARGETS[2],
    Target("W2", "workpiece", (180.0, 345.0, -90.0)),
    Target("W3", "workpiece", (190.0, 110.0, -30.0)),
)


def trunnion(targets: tuple[Target, ...] = TARGETS) -> Machine:
    return Machine(
        "trunnion",
        ("C", "A"),
        ("X", "Y", "Z"),
        (
            LinearAxis("X", 0.0, 500.0),
            LinearAxis("Y", 0.0, 450.0),
            LinearAxis("Z", 0.0, 400.0),
            RotaryAxis("A", -100.0, 30.0, (250.0, 225.0, -120.0), (1.0, 0.0, 0.0)),
            RotaryAxis("C", 0.0, 360.0, (250.0, 225.0, -170.0), (0.0, 0.0, 1.0)),
        ),
        targets,
        replace(TrackerNoise(), stands_on="base"),
    )


@pytest.fixture(scope="module")
def path() -> Path:
    return default_path(trunnion(), 6000.0)


def steps(path: Path) -> tuple[np.ndarray, np.ndarray]:
    step = np.diff(path.position, axis=0)
    return np.linalg.norm(step[:, :3], axis=1), np.abs(step[:, 3:]).max(axis=1)


def test_lines_go_straight_turn_and_do_both(path: Path) -> None:
    straight, turn = steps(path)
    assert ((straight > 0) & (turn == 0)).sum() > 8
    assert ((straight == 0) & (turn > 0)).sum() > 8
    assert ((straight > 0) & (turn > 0)).sum() > 8


def test_every_target_is_measured_and_the_machine_waits_while_it_changes(
    path: Path,
) -> None:
    assert list(dict.fromkeys(path.target)) == ["T1", "T2", "W1"]
    change = np.flatnonzero(np.array(path.target[1:]) != np.array(path.target[:-1])) + 1
    assert len(change) == 2
    assert (path.dwell_s[change] >= 5.0).all()
    assert (path.position[change] == path.position[change - 1]).all()


def test_the_path_stays_in_the_travel_and_below_the_fastest_feeds(path: Path) -> None:
    check_travel(trunnion(), path)
    straight, turn = steps(path)
    length = np.linalg.norm(np.diff(path.position, axis=0)[:, 3:], axis=1)
    length = np.where(straight > 0, straight, length)
    moved = length > 0
    minutes = length[moved] / path.feed_mm_min[1:][moved]
    assert (turn[moved] / minutes).max() < 1.001 * FASTEST_DEG_MIN
    assert (straight[moved] / minutes).max() < 1.001 * 6000.0


def test_rotary_axes_are_measured_over_all_their_travel(path: Path) -> None:
    assert np.ptp(path.position[:, 3]) > 120.0
    assert np.ptp(path.position[:, 4]) == 360.0


def test_the_target_moves_on_every_line(path: Path) -> None:
    mill = trunnion()
    for row in range(1, len(path)):
        target = mill.target(path.target[row])
        if path.target[row] != path.target[row - 1]:
            continue
        ends = path.position[row - 1 : row + 1]
        at = turning_conditions(mill, target, ends[:1], ends[1:])
        step = np.diff(at.point_mm, axis=0)
        assert np.linalg.norm(step, axis=1).sum() > 90.0


def test_the_same_seed_gives_the_same_path(path: Path) -> None:
    np.testing.assert_array_equal(path.position, default_path(trunnion()).position)
    other = default_path(trunnion(), seed=1, lines=6)
    assert not np.array_equal(other.position[:7], path.position[:7])


def uncertainty_mm(machine: Machine, path: Path) -> float:
    known = nothing_known_of_turning(machine)
    for row in range(1, len(path)):
        begin, end = path.position[row - 1 : row], path.position[row : row + 1]
        if (begin != end).any():
            at = turning_conditions(
                machine, machine.target(path.target[row]), begin, end
            )
            known = known.after(turning_rows(known, at, slopes_mm(at))[0])
    return known.belief.integrated_variance**0.5


def test_planned_lines_tell_more_than_random_ones_in_the_same_time(
    rng: np.random.Generator,
) -> None:
    mill = trunnion(SIX_TARGETS)
    path = default_path(mill)
    low = np.array([axis.low for axis in mill.axes])
    high = np.array([axis.high for axis in mill.axes])
    position = rng.uniform(low, high, path.position.shape)
    random = replace(path, position=position)
    assert travel_time_s(random) > 0.8 * travel_time_s(path)
    assert uncertainty_mm(mill, path) < 0.8 * uncertainty_mm(mill, random)


def test_a_machine_with_one_target_on_the_tool_is_planned_for() -> None:
    single = replace(trunnion((Target("", "tool", (0.0, 0.0, -150.0)),)))
    table = replace(single, tracker=TrackerNoise())
    path = default_path(table, lines=8)
    assert path.target == ()
    assert len(path) == 9
    moved = np.diff(standstill(table, path.position).point_mm, axis=0)
    assert np.isfinite(moved).all()


def test_a_target_on_the_axis_that_turns_it_is_refused_with_the_remedy() -> None:
    centre = Target("W1", "workpiece", (250.0, 225.0, -120.0))
    with pytest.raises(PlanningError, match=r"W1 hardly moves.*farther from the axes"):
        default_path(replace(trunnion((centre,)), workpiece_side=("C", "A")), lines=3)
