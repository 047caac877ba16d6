"""Planners of machines."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

from app.kinematics.machine import Machine, remove_rotary_axes
from app.motion.motion_times import Drive
from app.motion.workspace import Workspace
from app.planning.design_state import DesignState
from app.planning.initial_design import start_line_design, start_point_design
from app.planning.planner import Planner

STAND_MM = np.array([250.0, -900.0, 100.0])


@cache
def design_of(machine: Machine, kind: str, perpendicular_only: bool) -> DesignState:
    """What the estimator believes of a machine before the first line or point."""
    if kind == "points":
        return start_point_design(machine, STAND_MM)
    return start_line_design(machine, STAND_MM, perpendicular_only=perpendicular_only)


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
        part = remove_rotary_axes(machine) if kind == "lines" else machine
        dwell_s = 0.4 if kind == "lines" else 1.0
        return Planner(
            machine,
            design_of(machine, kind, perpendicular_only),
            workspace or Workspace(),
            Drive.of(part.axis_names, dwell_s),
            feeds,
        )

    return make
