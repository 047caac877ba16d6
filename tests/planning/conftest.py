"""Machines with and without rotary axes, for every test that needs a travel."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

from app.kinematics.machine import (
    LinearAxis,
    Machine,
    RotaryAxis,
    Target,
    TrackerNoise,
    linear_part,
)
from app.motion.motion_times import drive_of
from app.motion.workspace import Workspace
from app.planning.outlook import Outlook
from app.planning.outlooks import line_outlook, point_outlook
from app.planning.planner import Planner

STAND_MM = np.array([250.0, -900.0, 100.0])


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


@cache
def outlook_of(machine: Machine, kind: str, perpendicular_only: bool) -> Outlook:
    """What the estimator believes of a machine before the first line or point."""
    if kind == "points":
        return point_outlook(machine, STAND_MM)
    return line_outlook(machine, STAND_MM, perpendicular_only=perpendicular_only)


@pytest.fixture(scope="session")
def planner() -> Callable[..., Planner]:
    """Make a planner: planner(machine, kind, workspace=…, feeds=…)."""

    def make(
        machine: Machine,
        kind: str = "lines",
        *,
        workspace: Workspace | None = None,
        feeds: tuple[float, ...] = (6000.0,),
        perpendicular_only: bool = False,
    ) -> Planner:
        part = linear_part(machine) if kind == "lines" else machine
        dwell_s = 0.4 if kind == "lines" else 1.0
        return Planner(
            machine,
            outlook_of(machine, kind, perpendicular_only),
            workspace or Workspace(),
            drive_of(part, acceleration_mm_s2=1000.0, dwell_s=dwell_s),
            feeds,
        )

    return make
