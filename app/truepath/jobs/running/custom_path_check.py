"""User-defined rows as a measurement takes them, and what they leave undetermined."""

from __future__ import annotations

from collections.abc import Sequence

from truepath.errors import AlignmentError, PlanningError, Unidentifiable
from truepath.kinematics.machine.machine import Machine
from truepath.motion.configurations import Commanded
from truepath.motion.paths.commanded_rows import Row, check_feed, command_rows
from truepath.motion.workspace import Workspace
from truepath_drivers.interfaces.records import Path

_FEWEST = 3  # points that determine the tracker's pose


def command_measurable_rows(
    machine: Machine,
    rows: Sequence[Row],
    feed_mm_min: float | None,
    *,
    is_path: bool,
) -> Commanded:
    """Rows in the form that a measurement commands. Raises PlanningError.

    feed_mm_min : of rows without their own
    """
    check_feed(machine, feed_mm_min)
    commanded = command_rows(machine, rows, feed_mm_min, is_path=is_path)
    require_measurable(machine, commanded)
    return commanded


def require_measurable(machine: Machine, commanded: Commanded) -> None:
    """Raise PlanningError where rows do not determine the pose of the tracker.

    The target has to be at three points that are not on one straight line.
    """
    # Imported where it is needed: the service itself carries no science.
    from truepath.alignment.stream.nominal_path import (
        compute_nominal_path,
        require_spread,
    )

    place_mm = compute_nominal_path(machine, commanded).place_mm
    what = "the path" if isinstance(commanded, Path) else "the list of points"
    if len(place_mm) < _FEWEST:
        raise PlanningError(
            f"{what} has the target stand at {len(place_mm)} "
            f"{'place' if len(place_mm) == 1 else 'places'}; where the tracker stands "
            "is told by three at least that are not on one straight line: add rows, or "
            "give a plan more minutes"
        )
    try:
        require_spread(place_mm, what)
    except AlignmentError as error:
        raise PlanningError(str(error)) from error


def name_what_stays_open(
    machine: Machine, commanded: Commanded, workspace: Workspace
) -> str:
    """Parameters that these rows alone would not determine, as text; else empty.

    Such rows are measured all the same: Runs are analysed together as well, and another
    one may determine them.
    """
    # Imported where it is needed: the service itself carries no science.
    from truepath.planning.forecast import predict_undetermined
    from truepath.planning.initial_design import choose_station

    station_mm = choose_station(machine, workspace)
    try:
        return predict_undetermined(machine, commanded, station_mm)
    except (PlanningError, Unidentifiable) as error:
        return str(error)
