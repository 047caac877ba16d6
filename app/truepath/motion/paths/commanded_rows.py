"""Commanded rows, made and checked before anything moves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float64

from truepath.errors import PlanningError
from truepath.kinematics.machine.machine import Machine
from truepath.motion.configurations import Commanded, Configurations, name_columns
from truepath.motion.motion_times import DEFAULT_FEED_MM_MIN
from truepath.motion.nc_programs.programs import LARGEST_FEED_MM_MIN
from truepath.motion.workspace import check_travel
from truepath_drivers.interfaces.records import Path

MAX_ROWS = 4096
DEFAULT_DWELL_S = 1.0
LEAST_FEED_MM_MIN = 1.0

Row = Mapping[str, Any]
"""One row with the column names of `path.csv` or `points.csv`."""


def command_rows(
    machine: Machine,
    rows: Sequence[Row],
    feed_mm_min: float | None = None,
    *,
    is_path: bool,
) -> Commanded:
    """The checked path or points; PlanningError names the row.

    feed_mm_min : of rows that have none
    """
    axes, position = machine.axis_names, _positions(machine, rows)
    dwell_s = np.array([row.get("dwell_s", DEFAULT_DWELL_S) for row in rows], float)
    target = _targets(machine, rows)
    commanded: Commanded
    if is_path:
        typical = feed_mm_min or DEFAULT_FEED_MM_MIN
        feeds = np.array([row.get("feed_mm_min") or typical for row in rows], float)
        check_feeds(machine, feeds)
        commanded = Path(axes, position, feeds, dwell_s, target)
        _reject_standing_lines(commanded)
    else:
        commanded = Configurations(axes, position, dwell_s, target)
    if len(commanded) > MAX_ROWS:
        raise PlanningError(
            f"the plan has {len(commanded)} rows; a controller takes {MAX_ROWS}"
        )
    check_travel(machine, commanded)
    return commanded


def _positions(machine: Machine, rows: Sequence[Row]) -> Float64[np.ndarray, "n a"]:
    columns = name_columns(machine.axis_names)
    for number, row in enumerate(rows, 1):
        given = {name for name in row if name.endswith(("_mm", "_deg"))}
        for names, problem in (
            (given - set(columns), "no axis of the machine"),
            (set(columns) - given, "missing"),
        ):
            if names:
                raise PlanningError(f"row {number}: {min(names)} is {problem}")
    return np.array([[row[name] for name in columns] for row in rows], float)


def _targets(machine: Machine, rows: Sequence[Row]) -> tuple[str, ...]:
    if not any(row.get("target") for row in rows):
        return ()
    names = tuple(str(row.get("target") or "") for row in rows)
    known = sorted(target.name for target in machine.targets)
    for number, name in enumerate(names, 1):
        if name not in known:
            raise PlanningError(
                f"row {number}: target {name!r} is unknown; the machine has "
                f"{', '.join(filter(None, known)) or 'one target without a name'}"
            )
    return names


def _reject_standing_lines(path: Path) -> None:
    if len(path) < 2:
        raise PlanningError("a path of one row has no line; give at least two rows")
    for index in range(1, len(path)):
        same_target = not path.target or path.target[index] == path.target[index - 1]
        if same_target and (path.position[index] == path.position[index - 1]).all():
            raise PlanningError(
                f"row {index + 1}: the line starts where it ends; remove the row, or "
                "give a longer dwell_s to stand still"
            )


def check_feeds(machine: Machine, feed_mm_min: Float64[np.ndarray, " n"]) -> None:
    """Raise PlanningError for the first row with an impossible feed."""
    possible = _find_possible(machine, feed_mm_min)
    if not possible.all():
        row = int(np.argmin(possible))
        raise PlanningError(f"row {row + 1}: {_explain(machine, feed_mm_min[row])}")


def check_feed(machine: Machine, feed_mm_min: float | None) -> None:
    """Raise PlanningError for an impossible feed of the whole request."""
    if feed_mm_min is None:
        return
    if not _find_possible(machine, np.array([feed_mm_min])).all():
        raise PlanningError(_explain(machine, feed_mm_min))


def _find_possible(
    machine: Machine, feed_mm_min: Float64[np.ndarray, " n"]
) -> np.ndarray:
    highest = _find_highest(machine)
    return (feed_mm_min >= LEAST_FEED_MM_MIN) & (feed_mm_min <= highest)


def _find_highest(machine: Machine) -> float:
    if "max_feed_mm_min" in machine.motion.assumed:
        return LARGEST_FEED_MM_MIN
    return machine.motion.max_feed_mm_min


def _explain(machine: Machine, feed_mm_min: float) -> str:
    return (
        f"a feed of {feed_mm_min:g} mm/min cannot be driven by {machine.name}; give "
        f"{LEAST_FEED_MM_MIN:g} to {_find_highest(machine):g} mm/min"
    )
