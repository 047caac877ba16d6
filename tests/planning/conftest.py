"""Planners of machines."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

from truepath.app.kinematics.machine import Machine, remove_rotary_axes
from truepath.app.motion.motion_times import Drive
from truepath.app.motion.workspace import Workspace
from truepath.app.planning.design_state import DesignState
from truepath.app.planning.forecast import Assumptions
from truepath.app.planning.initial_design import start_design
from truepath.app.planning.line_design import LineDesignState
from truepath.app.planning.next_configuration import PointDesignState
from truepath.app.planning.planner import Planner

STAND_MM = np.array([250.0, -900.0, 100.0])


@cache
def design_of(machine: Machine, kind: str, perpendicular_only: bool) -> DesignState:
    """What the estimator believes of a machine before the first line or point."""
    if kind == "points":
        drive = Drive.of(machine.axis_names, 1.0)
        return start_design(PointDesignState, machine, STAND_MM, drive, target="")
    drive = Drive.of(remove_rotary_axes(machine).axis_names, 0.4)
    assumed = Assumptions(perpendicular_only=perpendicular_only)
    return start_design(LineDesignState, machine, STAND_MM, drive, assumed)


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
        return Planner(
            machine,
            design_of(machine, kind, perpendicular_only),
            workspace or Workspace(),
            feeds,
        )

    return make
