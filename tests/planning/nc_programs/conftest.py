"""Machines with and without rotary axes, for every program."""

from __future__ import annotations

import pytest

from app.kinematics.machine import (
    LinearAxis,
    Machine,
    RotaryAxis,
    Target,
    TrackerNoise,
)


@pytest.fixture(scope="session")
def mill() -> Machine:
    """Three linear axes, Z downwards."""
    return Machine(
        "small mill",
        ("X",),
        ("Y", "Z"),
        (LinearAxis("X", 0, 500), LinearAxis("Y", 0, 400), LinearAxis("Z", -300, 0)),
        (Target("", "tool", (20.0, 30.0, -150.0)),),
        TrackerNoise(),
    )


@pytest.fixture(scope="session")
def trunnion(mill: Machine) -> Machine:
    """A tilting table under a mill, and a target on each side."""
    return Machine(
        "trunnion mill",
        ("C", "A"),
        ("X", "Y", "Z"),
        (
            *mill.axes,
            RotaryAxis("A", -110, 30, (0.0, 20.0, 10.0), (1.0, 0.0, 0.0)),
            RotaryAxis("C", 0, 360, (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
        ),
        (Target("T", "tool", (0, 0, -80)), Target("W", "workpiece", (90, 0, 0))),
        TrackerNoise(stands_on="base"),
    )
