"""The live estimator's normal equations: finished cells added while more come.

They equal those of the batch to rounding however the cells were split, and their size
does not grow with the number of lines.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from app.alignment.observations import Observations
from app.errors import EstimationError
from app.estimation.design_matrix import Linearisation
from app.estimation.information import Information
from app.estimation.normal_equations import NormalEquations


@dataclass(frozen=True)
class RecursiveEstimator:
    """All cells so far under one linearisation.

    time_s : of the last cell
    """

    linearisation: Linearisation
    sums: NormalEquations
    time_s: float = -np.inf
    cells: int = 0

    @staticmethod
    def start(linearisation: Linearisation) -> RecursiveEstimator:
        """Return the estimator before its first cell."""
        return RecursiveEstimator(
            linearisation, NormalEquations.empty(linearisation.size)
        )

    def add(self, observations: Observations) -> RecursiveEstimator:
        """Return it with further cells, which are later than all before.

        Raises EstimationError if they are not in order of time.
        """
        time_s, line = observations.at.time_s, observations.at.line
        if not (np.diff(time_s, prepend=self.time_s) > 0.0).all():
            raise EstimationError("cells have to be added in order of time")
        sums = self.sums
        begins = np.flatnonzero(np.diff(line, prepend=line[:1] - 1))
        for cells in np.split(np.arange(len(observations)), begins[1:]):
            design = self.linearisation.build(observations.select(cells))
            sums = sums.add(design, self.linearisation.noise)
        return replace(
            self,
            sums=sums,
            time_s=float(time_s[-1]),
            cells=self.cells + len(observations),
        )

    def information(self) -> Information:
        """Return the information on machine and pose, all else integrated out."""
        return self.sums.information()
