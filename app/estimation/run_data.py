"""The data of one Run that terms are fitted to, in fine cells and within them."""

from __future__ import annotations

from dataclasses import dataclass

from app.alignment.observations import Observations
from app.estimation.baseline import Baseline, with_pose
from app.estimation.design_matrix import Linearisation
from app.estimation.within_cells import Within, within_cells
from app.files.run import Run


@dataclass(frozen=True)
class RunData:
    """Cells of a Run where the baseline places its tracker.

    base : machine, poses and noise that all fits share
    within : samples within the cells, where fast effects show
    """

    observations: Observations
    base: Linearisation
    within: Within | None = None


def place_run(run: Run, observations: Observations, baseline: Baseline) -> RunData:
    """Return the data of a Run with its pose and noise in the baseline."""
    base = baseline.linearise(observations.at.run)
    placed = with_pose(observations, base.pose)
    return RunData(placed, base, within_cells(run, placed, base))
