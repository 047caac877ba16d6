"""A Run as discovery needs it: aligned in fine and in coarse cells.

Fine cells show what repeats with a screw; the noise is fitted to coarse ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from app.alignment.align import align
from app.alignment.observations import Observations, add_surroundings
from app.files.run import Run
from app.kinematics.conditions import Conditions

FINE_CELL_MM = 3.0  # a wave of 6 mm keeps two thirds of its height


@dataclass(frozen=True)
class AlignedRun:
    """A Run cut into fine and coarse cells that know their surroundings."""

    run: Run
    observations: Observations
    coarse: Observations

    @property
    def at(self) -> Conditions:
        """Conditions of the fine cells."""
        return self.observations.at


def align_runs(runs: Sequence[Run]) -> tuple[AlignedRun, ...]:
    """Align Runs in fine and in coarse cells.

    Raises AlignmentError if stream and path of a Run do not belong together.
    """
    return tuple(
        AlignedRun(
            run,
            _add_surroundings(run, align(run, cell_mm=FINE_CELL_MM), number),
            _add_surroundings(run, align(run), number),
        )
        for number, run in enumerate(runs)
    )


def _add_surroundings(
    run: Run, observations: Observations, number: int
) -> Observations:
    """Return observations of a Run with its number and their surroundings.

    The first point of a standstill Run is left out: the side that the machine reached
    it from is unknown, and an axis with play stands elsewhere from either side.
    """
    if run.mode == "standstill":
        later = np.flatnonzero(observations.row > 0)
        observations = observations.select(later)
    return add_surroundings(observations, run.commanded, run.temperature, number)
