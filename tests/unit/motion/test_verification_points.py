"""Points of verification: inside the travel, of their standard, and drawn again."""

import numpy as np
import pytest

from truepath.errors import BadInput, PlanningError
from truepath.motion.motion_times import row_times_s
from truepath.motion.paths.verification_kinds import VerificationKind
from truepath.motion.paths.verification_points import (
    RANDOM_POINTS,
    make_verification_points,
    make_verification_rows,
)
from truepath.motion.workspace.line_of_sight import Box
from truepath.motion.workspace.travel import check_travel
from truepath.motion.workspace.workspace import Workspace


@pytest.mark.parametrize("kind", VerificationKind)
def test_points_stay_in_the_travel(mill, kind):
    points = make_verification_rows(mill, [kind], 3)
    check_travel(mill, points)
    minutes = float(row_times_s(points, 10_000.0, mill.motion).sum()) / 60.0
    assert minutes < 8.0


def test_a_path_of_circles_is_not_mixed_with_points(mill):
    with pytest.raises(BadInput, match="ask for each by itself"):
        make_verification_rows(mill, list(VerificationKind), 1)


def make_points(mill, kind, seed=1, *workspace):
    return make_verification_points(mill, [kind], seed, *workspace)


def test_a_seed_draws_the_same_points_again_and_another_one_others(mill):
    kind = VerificationKind.RANDOM_POINTS
    first, again, other = (make_points(mill, kind, seed).position for seed in (1, 1, 2))
    assert first.shape == (RANDOM_POINTS, 3)
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 1.0


def test_random_points_and_the_ways_between_them_keep_clear_of_boxes(mill):
    low, high = np.array([(axis.low, axis.high) for axis in mill.axes]).T
    middle, size = (low + high) / 2, (high - low) / 4
    vice = Box(tuple(middle - size), tuple(middle + size), "vice")
    workspace = Workspace(keep_out=(vice,))
    for seed in range(5):
        points = make_points(mill, VerificationKind.RANDOM_POINTS, seed, workspace)
        assert len(points) == RANDOM_POINTS
        workspace.refuse(mill, points)
    full = Workspace(keep_out=(Box(tuple(low), tuple(high)),))
    with pytest.raises(PlanningError, match="leaves room for 0 of 30 random points"):
        make_points(mill, VerificationKind.RANDOM_POINTS, 1, full)


def test_every_target_of_an_axis_is_come_to_five_times_from_both_sides(mill):
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


def test_four_body_diagonals_are_driven_from_corner_to_corner(mill):
    points = make_points(mill, VerificationKind.DIAGONALS)
    low, high = points.position.min(axis=0), points.position.max(axis=0)
    at_corner = ((points.position == low) | (points.position == high)).all(axis=1)
    assert len(np.unique(points.position[at_corner], axis=0)) == 8
