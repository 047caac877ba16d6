"""Planners of machines."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from truepath.kinematics.machine.machine import remove_rotary_axes
from truepath.motion.motion_times import Drive
from truepath.motion.workspace import Workspace
from truepath.planning.design_state import LineDesignState
from truepath.planning.forecast import Assumptions
from truepath.planning.initial_design import start_design
from truepath.planning.next_configuration import PointDesignState
from truepath.planning.planner import Planner

STAND_MM = np.array([250.0, -900.0, 100.0])


@pytest.fixture(scope="session")
def small_mill(mill):
    axes = [replace(a, low=a.low / 2.0, high=a.high / 2.0) for a in mill.linear_axes]
    return replace(mill, axes=tuple(axes))


@cache
def design_of(machine, kind, perpendicular_only):
    if kind == "points":
        drive = Drive.of(machine.axis_names, 1.0)
        return start_design(PointDesignState, machine, STAND_MM, drive, target="")
    drive = Drive.of(remove_rotary_axes(machine).axis_names, 0.4)
    assumed = Assumptions(perpendicular_only=perpendicular_only)
    return start_design(LineDesignState, machine, STAND_MM, drive, assumed)


@pytest.fixture(scope="session")
def planner():
    def make(machine, kind="lines", *, workspace=None, feeds=(6000.0,), across=False):
        design = design_of(machine, kind, across)
        return Planner(machine, design, workspace or Workspace(), feeds)

    return make
