"""What discovery looks at: fine cells with their surroundings, and the base model."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from app.alignment.align import align
from app.alignment.observations import Observations
from app.alignment.surroundings import with_surroundings
from app.files.run import Run
from app.kinematics.conditions import Conditions
from app.numerics.rigid import RigidTransform

CELL_MM = 3.0  # a wave of 6 mm keeps two thirds of its height


@dataclass(frozen=True)
class Scene:
    """A Run cut into cells that know their surroundings."""

    run: Run
    seen: Observations

    @property
    def at(self) -> Conditions:
        """Conditions of the cells."""
        return self.seen.at


def scene_of(run: Run, number: int = 0) -> Scene:
    """Align a Run in cells short enough to show what repeats with a screw.

    number : which of several Runs it is

    Raises AlignmentError if stream and path do not belong together.
    """
    return Scene(run, in_surroundings(run, align(run, cell_mm=CELL_MM), number))


def in_surroundings(run: Run, seen: Observations, number: int) -> Observations:
    """Return observations of a Run with their surroundings.

    The first point of a standstill Run is left out: nobody knows from which side the
    machine came to it, and an axis with play stands elsewhere from either side.
    """
    if run.mode == "standstill":
        seen = seen.taken(np.flatnonzero(seen.row > 0))
    return with_surroundings(seen, run.commanded, run.temperature, number)


def at_pose(seen: Observations, pose: RigidTransform) -> Observations:
    """Return the observations with another pose."""
    around = seen.at.recorded
    if around is not None:
        around = replace(around, rotation=pose.rotation)
    return replace(seen, pose=pose, at=replace(seen.at, recorded=around))
