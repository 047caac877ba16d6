"""A result with random errors, as large as those of a machine."""

import numpy as np
import pytest

from results_fixtures import ONE_TARGET, build_model_of
from truepath.files.earlier.result_file import CalibrationResult


@pytest.fixture(scope="session")
def loaded():
    model, merged, size = build_model_of(ONE_TARGET)
    theta = size * np.random.default_rng(5).standard_normal(model.size)
    covariance = np.diag((1e-2 * size) ** 2)
    return CalibrationResult(model, theta, covariance, unobservable=merged)
