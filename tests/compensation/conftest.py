"""A result with random errors, as large as those of a machine."""

from __future__ import annotations

import numpy as np
import pytest

from truepath.files.earlier.result_file import CalibrationResult
from truepath.kinematics.identifiable import build_identifiable_model
from truepath.kinematics.machine.machine import LinearAxis, Machine, Target
from truepath.kinematics.machine.tracker_noise import TrackerNoise

MACHINE = Machine(
    "bench mill",
    ("X",),
    ("Y", "Z"),
    (
        LinearAxis("X", -200.0, 300.0),  # zero inside the travel
        LinearAxis("Y", 10.0, 400.0),  # zero outside: the lowest position stands in
        LinearAxis("Z", 0.0, 310.0),
    ),
    (Target("", "tool", (20.0, 30.0, -150.0)),),
    TrackerNoise(),
)


@pytest.fixture(scope="session")
def loaded() -> CalibrationResult:
    offsets = np.array([target.offset_mm for target in MACHINE.targets])
    model, confounded = build_identifiable_model(MACHINE, offsets, knot_spacing_mm=90.0)
    # Millimetres and radians differ in size as they do in a machine.
    size = np.array([1e-2 if p.unit == "mm" else 4e-5 for p in model.parameters])
    rng = np.random.default_rng(5)
    theta = size * rng.standard_normal(model.size)
    return CalibrationResult(
        model,
        theta,
        np.diag((1e-2 * size) ** 2),
        unobservable=tuple(str(one) for one in confounded),
    )
