"""The path used without a plan.

It is the planner's, by legs instead of time: as many long lines as determine the
machine well. Where there are rotary axes, lines go straight, turn, or do both, and
every target that moves is measured in a separate block of lines, the first one again at
the end. Targets complement each other: tool targets determine the axes of the tool side
and, seen from the workpiece, all others; targets on the table determine, seen from the
base, the axes that carry it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from truepath.errors import PlanningError
from truepath.kinematics.machine.machine import Machine, Target
from truepath.motion.configurations import join_rows
from truepath.motion.motion_times import DEFAULT_FEED_MM_MIN, Drive
from truepath.motion.workspace import Workspace, inner_travel, moving_targets
from truepath.planning.design_state import LineDesignState
from truepath.planning.initial_design import choose_station, start_design
from truepath.planning.planner import Planner, SearchEffort
from truepath.planning.target_blocks import (
    ExpectedLegs,
    PlanShare,
    plan_in_turn,
    wait_for_tracker,
)
from truepath_drivers.interfaces.records import Path

DEFAULT_LINES = 22  # a minute and a half on a small mill
LINES_WITH_ROTARY_AXES = 72
_DWELL_S = 0.35
_LONG = 0.55  # of the diagonal of the travel: no line is shorter


def default_path(
    machine: Machine,
    feed_mm_min: float | None = None,
    *,
    lines: int | None = None,
    seed: int = 0,
) -> Path:
    """A path of long lines through the travel, of all axes.

    Each line starts where the last one stopped. The same seed gives the same path. The
    feed is lower where a rotary axis would turn faster than FASTEST_DEG_MIN; where no
    linear axis moves it is in deg/min.

    feed_mm_min : None for the default, or the highest of the machine
    lines : None for 22, or 72 with rotary axes
    Raises PlanningError if a feed or a number of lines is impossible, or if no target
    moves where the tracker stands.
    """
    targets = moving_targets(machine) if machine.rotary_axes else machine.targets[:1]
    if lines is None:
        lines = LINES_WITH_ROTARY_AXES if machine.rotary_axes else DEFAULT_LINES
    if feed_mm_min is None:
        feed_mm_min = min(DEFAULT_FEED_MM_MIN, machine.motion.max_feed_mm_min)
    if feed_mm_min <= 0 or lines < 1:
        raise PlanningError(
            f"feed {feed_mm_min:g} mm/min, {lines} lines: both must be above 0"
        )
    # If stops were moved, all axes would move on every line.
    effort = SearchEffort(40, 0) if machine.rotary_axes else SearchEffort(rounds=1)
    counts = np.diff(np.arange(len(targets) + 1) * lines // len(targets)).tolist()
    shares: list[PlanShare] = []
    for target, count in zip(targets, counts, strict=True):
        if count:
            planner = _make_planner(machine, target, feed_mm_min)
            expected = ExpectedLegs.draw(planner, seed).inform(count)
            shares.append(PlanShare(planner, legs=count, expected=expected))
    blocks = plan_in_turn(shares, seed=seed, effort=effort)
    wait_for_tracker(blocks)
    path = join_rows(blocks)
    assert isinstance(path, Path)  # noqa: S101 (lines make a path)
    return replace(path, feed_mm_min=np.round(path.feed_mm_min, 1))


def _make_planner(machine: Machine, target: Target, feed_mm_min: float) -> Planner:
    drive = Drive.of_lines(machine, _DWELL_S)
    if not machine.rotary_axes:
        low, high = inner_travel(machine)
        drive = replace(drive, least_mm=_LONG * float(np.linalg.norm(high - low)))
    workspace = Workspace()
    design = start_design(
        LineDesignState,
        machine,
        choose_station(machine, workspace),
        drive,
        target=target.name if machine.rotary_axes else None,
    )
    return Planner(machine, design, workspace, (feed_mm_min,))
