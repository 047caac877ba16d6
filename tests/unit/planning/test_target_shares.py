"""Targets share the time of a plan by what each tells."""

from __future__ import annotations

from dataclasses import replace

import pytest
from tests.unit.planning.test_default_path import trunnion

from truepath.kinematics.machine.machine import Machine
from truepath.motion.motion_times import Drive
from truepath.motion.workspace.workspace import Workspace, moving_targets
from truepath.planning.initial_design import choose_station, start_design
from truepath.planning.lines.line_design import LineDesignState
from truepath.planning.lines.planner import Planner
from truepath.planning.lines.target_shares import share_among_targets

CHANGE_S = 5.0


@pytest.fixture(scope="module")
def machine() -> Machine:
    return trunnion()


@pytest.fixture(scope="module")
def planners(machine: Machine) -> list[Planner]:
    workspace = Workspace()
    design = start_design(
        LineDesignState,
        machine,
        choose_station(machine, workspace),
        Drive.of_lines(machine, 0.4),
        target="T1",
    )
    first = Planner(machine, design, workspace, (6000.0,))
    return [
        replace(first, design=replace(design, target=target))
        for target in moving_targets(machine)
    ]


def test_all_time_but_that_of_turning_the_tracker_is_shared(planners) -> None:
    shares = share_among_targets(planners, 240.0, CHANGE_S, 0)
    total = sum(share.budget_s for share in shares)
    assert total == pytest.approx(240.0 - CHANGE_S * len(shares))
    assert min(share.budget_s for share in shares) >= 10.0


def test_in_a_short_time_fewer_targets_are_measured(planners) -> None:
    assert len(share_among_targets(planners, 18.0, CHANGE_S, 0)) < len(planners)
