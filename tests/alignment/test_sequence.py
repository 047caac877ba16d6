"""Rigid fits of one point set to another."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from truepath.numerics.rigid import RigidTransform, fit_rigid


@pytest.fixture
def motion(rng):
    rotation = Rotation.random(rng=rng).as_matrix()
    return RigidTransform(rotation, np.array([300.0, -200.0, 50.0]))


def test_a_rigid_motion_is_found_from_its_points(rng, motion):
    points = rng.uniform(0, 500, (10, 3))
    found = fit_rigid(points, motion.apply(points))
    assert np.allclose(found.rotation, motion.rotation, atol=1e-12)
    assert np.allclose(found.translation_mm, motion.translation_mm, atol=1e-9)


def test_a_mirror_image_is_fitted_only_when_asked(rng, motion):
    points = rng.uniform(0, 500, (10, 3))
    mirrored = motion.apply(points * [1, 1, -1])
    proper, improper = (
        fit_rigid(points, mirrored, mirrored=flag).apply(points) - mirrored
        for flag in (False, True)
    )
    assert np.abs(improper).max() < 1e-9
    assert np.abs(proper).max() > 10.0
