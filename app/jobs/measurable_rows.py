"""Rows that no analysis could take, refused before the machine drives them."""

from __future__ import annotations

from truepath.app.errors import AlignmentError, PlanningError
from truepath.app.kinematics.machine import Machine
from truepath.app.motion.configurations import Commanded
from truepath.drivers.interfaces.records import Path

_FEWEST = 3  # places that fix where the tracker stands


def require_measurable(machine: Machine, commanded: Commanded) -> None:
    """Raise PlanningError where rows cannot tell where the tracker stands.

    The target has to stand at three places that are not on one straight line.
    """
    # Imported where it is needed: the service itself carries no science.
    from truepath.app.alignment.nominal_path import compute_nominal_path, require_spread

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
