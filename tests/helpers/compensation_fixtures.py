"""A result with random errors, as large as those of a machine."""

import numpy as np
import pytest

from results_fixtures import ONE_TARGET, machine_with
from truepath.files.earlier.result_file import CalibrationResult
from truepath.kinematics.identifiable import build_identifiable_model

MACHINE = machine_with(ONE_TARGET)


@pytest.fixture(scope="session")
def loaded():
    offsets = np.array([target.offset_mm for target in MACHINE.targets])
    model, confounded = build_identifiable_model(MACHINE, offsets, knot_spacing_mm=90.0)
    # Millimetres and radians differ in size as they do in a machine.
    size = np.array([1e-2 if p.unit == "mm" else 4e-5 for p in model.parameters])
    rng = np.random.default_rng(5)
    theta = size * rng.standard_normal(model.size)
    covariance, merged = np.diag((1e-2 * size) ** 2), tuple(map(str, confounded))
    return CalibrationResult(model, theta, covariance, unobservable=merged)
