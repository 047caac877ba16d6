"""What a cell weighs is the inverse of how far its noise may take it."""

import numpy as np
import pytest

from truepath.alignment.align import align
from truepath.estimation.problem.noise import (
    NoiseModel,
    cell_noise,
    split_sigma_mm,
    total_precision,
)

NOISE = NoiseModel((1.0, 1.5), (0.3, 0.2, 0.4), 0.9, 3e-3, ramp_sigma_mm=2e-3)


@pytest.fixture(scope="module")
def seen(record_small):
    return align(record_small(3)[0])


@pytest.fixture(scope="module")
def travel(seen):
    found = np.random.default_rng(3).normal(size=(len(seen), 3))
    return found / np.linalg.norm(found, axis=1)[:, None]


@pytest.mark.parametrize("is_correlated_noise_in_it", [True, False])
def test_precision_is_the_inverse_covariance_with_jitter_along_the_travel(
    seen, travel, is_correlated_noise_in_it
):
    white, ou = split_sigma_mm(seen, NOISE)
    if is_correlated_noise_in_it:
        variance, found = white**2 + ou**2, total_precision(seen, NOISE, travel)
    else:
        variance, (found, sigma) = white**2, cell_noise(seen, NOISE, travel)
        np.testing.assert_array_equal(sigma, ou)
    along = 3e-3**2 * travel[:, :, None] * travel[:, None, :]
    steady, ramp = ~seen.is_ramp, seen.is_ramp
    covariance = variance[:, :, None] * np.eye(3) + along
    expected = np.linalg.inv(covariance)
    np.testing.assert_allclose(found[steady], expected[steady], rtol=1e-9, atol=1e-3)
    # On a ramp nothing counts that lies along the travel.
    assert ramp.any()
    left = np.einsum("nij,nj->ni", found[ramp], travel[ramp])
    assert np.abs(left).max() < 1e-6 * np.abs(found).max()


def test_standard_deviations_are_of_means_of_samples_and_wider_on_ramps(seen):
    white, ou = split_sigma_mm(seen, NOISE)
    distance_mm = np.linalg.norm(seen.tracker_mm, axis=1)
    stated = seen.at.machine.tracker.sigma_mm(distance_mm)[:, [0, 1, 1]]
    mean = stated * [1.0, 1.5, 1.5] / np.sqrt(seen.count)[:, None]
    np.testing.assert_allclose(white[~seen.is_ramp], mean[~seen.is_ramp])
    on_ramp = np.hypot(mean, 2e-3)[seen.is_ramp]
    np.testing.assert_allclose(white[seen.is_ramp], on_ramp)
    np.testing.assert_allclose(ou, stated * [0.3, 0.2, 0.4])
