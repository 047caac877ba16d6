"""One recording through the product, and what is then left of the machine's error."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from judging import Volume, map_mm, true_map_mm, volume
from recordings import run_of

from truepath.alignment.align import align_all
from truepath.alignment.observations.observations import Observations
from truepath.estimation.solve.batch import Estimate, estimate
from truepath.kinematics.coarse_model import build_run_models
from truepath_simulators.worlds.recording import Recording


@dataclass(frozen=True)
class Study:
    """A recording with its estimate; maps (n, 3) over the volume, in mm.

    truth_mm, found_mm : without the rigid motion of the whole volume
    sigma_mm : stated standard uncertainty of the map
    """

    recording: Recording
    seen: Observations
    found: Estimate
    within: Volume
    truth_mm: np.ndarray
    found_mm: np.ndarray
    sigma_mm: np.ndarray

    @property
    def left_mm(self) -> np.ndarray:
        """What compensation by the estimate would leave, (n, 3)."""
        return self.truth_mm - self.found_mm

    @property
    def share_left(self) -> float:
        """Mean length of the error left over that before."""
        return self.within.mean_length(self.left_mm) / self.within.mean_length(
            self.truth_mm
        )

    @property
    def covered(self) -> float:
        """Share of the volume's components inside their 95 % intervals."""
        return self.within.share(np.abs(self.left_mm) < 1.96 * self.sigma_mm)


def study(
    recording: Recording,
    *,
    perpendicular_only: bool = False,
    seen: Observations | None = None,
) -> Study:
    """Align and estimate as the product does; judge by the exact truth."""
    run = run_of(recording)
    seen = seen or align_all([run], [run.name])[0]
    models = build_run_models(seen.at.machine, [seen.at])
    found = estimate(models, [seen], perpendicular_only=perpendicular_only)
    within = volume(run.machine)
    error, sigma = map_mm(within, found.model, found.theta, found.covariance)
    truth = true_map_mm(within, recording.truth)
    return Study(recording, seen, found, within, truth, error, sigma)
