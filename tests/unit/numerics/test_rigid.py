"""Rigid motions, small ones among them, and fits of one point set to another."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from truepath.numerics.rigid import RigidTransform, cross_matrix, fit_rigid


@pytest.fixture
def motion(rng):
    rotation = Rotation.random(rng=rng).as_matrix()
    return RigidTransform(rotation, np.array([300.0, -200.0, 50.0]))


@pytest.fixture
def points(rng):
    return rng.uniform(0, 500, (10, 3))


def test_motions_are_undone_and_small_ones_precede_the_pose(points, motion, rng):
    assert np.allclose(motion.invert().apply(motion.apply(points)), points)
    rotation, translation = np.array([1e-5, -2e-5, 3e-5]), np.array([0.01, -0.02, 0.03])
    moved = motion.apply(points + np.cross(rotation, points) + translation)
    small_first = motion.precede_small(rotation, translation)
    assert np.allclose(small_first.apply(points), moved, atol=1e-6)
    turn = rng.normal(size=3)
    assert np.allclose(cross_matrix(points) @ turn, np.cross(turn, points))


def test_a_rigid_motion_is_found_and_a_mirror_image_when_asked(points, motion):
    found = fit_rigid(points, motion.apply(points))
    assert np.allclose(found.rotation, motion.rotation, atol=1e-12)
    assert np.allclose(found.translation_mm, motion.translation_mm, atol=1e-9)
    mirrored = motion.apply(points * [1, 1, -1])
    fits = (fit_rigid(points, mirrored, mirrored=flag) for flag in (False, True))
    proper, improper = (np.abs(fit.apply(points) - mirrored).max() for fit in fits)
    assert improper < 1e-9
    assert proper > 10.0
