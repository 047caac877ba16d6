import numpy as np
import pytest
from scipy.stats import qmc

from truepath.numerics.sobol import MOST_DIMENSIONS, compute_sobol_points


@pytest.mark.parametrize("dimensions", range(1, MOST_DIMENSIONS + 1))
@pytest.mark.parametrize("count", [1, 2, 256])
def test_points_are_those_of_scipy(dimensions, count):
    expected = qmc.Sobol(dimensions, rng=np.random.default_rng(0)).random(count)
    assert np.array_equal(compute_sobol_points(dimensions, count), expected)
