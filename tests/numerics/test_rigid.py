"""Rigid motions, small ones among them."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from truepath.numerics.rigid import RigidTransform, cross_matrix


@pytest.fixture
def motion(rng):
    rotation = Rotation.random(rng=rng).as_matrix()
    return RigidTransform(rotation, np.array([300.0, -200.0, 50.0]))


def test_inverse_undoes(rng, motion):
    points = rng.uniform(0, 500, (10, 3))
    assert np.allclose(motion.invert().apply(motion.apply(points)), points)


def test_a_small_motion_first_moves_points_before_the_pose(rng, motion):
    points, rotation = rng.uniform(0, 500, (5, 3)), np.array([1e-5, -2e-5, 3e-5])
    translation = np.array([0.01, -0.02, 0.03])
    moved = points + np.cross(rotation, points) + translation
    assert np.allclose(
        motion.precede_small(rotation, translation).apply(points),
        motion.apply(moved),
        atol=1e-6,
    )


def test_cross_matrix_turns_points(rng):
    points, rotation = rng.normal(size=(4, 3)), rng.normal(size=3)
    assert np.allclose(cross_matrix(points) @ rotation, np.cross(rotation, points))
