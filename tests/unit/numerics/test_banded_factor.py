"""A banded factor is solved in chunks as the dense one."""

import numpy as np
import pytest

from truepath.numerics.banded_factor import BandedFactor


@pytest.mark.parametrize("size", [1, 3, 23, 24, 25, 48, 100])
@pytest.mark.parametrize("below", [1, 3])
def test_a_banded_factor_is_solved_as_the_dense_one(rng, size, below):
    factor = rng.uniform(-1.0, 1.0, (below + 1, size))
    factor[0] = rng.uniform(3.0, 5.0, size)
    dense = np.zeros((size, size))
    for i in range(min(below + 1, size)):
        dense += np.diag(factor[i, : size - i], -i)
    right = rng.normal(size=(size, 5))
    banded = BandedFactor.of(factor)
    half, whole = banded.solve_half(right), banded.solve(right)
    assert np.allclose(dense @ half, right, rtol=1e-12, atol=1e-12)
    assert np.allclose(dense @ (dense.T @ whole), right, rtol=1e-11, atol=1e-11)
