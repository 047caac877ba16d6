"""Errors of the tracker as in `machine.json`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from truepath.kinematics.machine.tracker_specification import TrackerSpecification


@dataclass(frozen=True, slots=True)
class TrackerNoise:
    """Standard deviations of one sample, sample rate, and position of the tracker.

    specification : of its systematic errors; None where it is not stated
    face : 1 or 2, in which it measures; None if it has only one
    """

    range_sigma_um: float = 1.0
    range_ppm: float = 0.3
    angle_sigma_urad: float = 3.0
    transverse_sigma_um: float = 4.0
    rate_hz: float = 500.0
    stands_on: str = "workpiece"
    specification: TrackerSpecification | None = None
    face: int | None = None

    @property
    def systematic(self) -> TrackerSpecification:
        """The specification in the file, or a typical one."""
        return self.specification or TrackerSpecification()

    def sigma_mm(
        self, distance_mm: Float64[np.ndarray, " n"]
    ) -> Float64[np.ndarray, "n 2"]:
        """Standard deviation of one sample along and across the beam, (n, 2)."""
        along = self.range_sigma_um + self.range_ppm * distance_mm * 1e-3
        across = np.hypot(
            self.angle_sigma_urad * distance_mm * 1e-3, self.transverse_sigma_um
        )
        return np.stack([along, across], axis=1) * 1e-3
