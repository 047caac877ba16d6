"""Systematic errors of a tracker within its specification, as in its file."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64


@dataclass(frozen=True, slots=True)
class TrackerSpecification:
    """Standard uncertainties of systematic errors; defaults are a typical tracker's.

    A term of 0 is left out.
    """

    index_urad: float = 10.0
    eccentricity_urad: float = 4.0
    encoder_urad: float = 4.0
    fine_urad: float = 1.5
    beam_offset_um: float = 5.0
    transit_offset_um: float = 5.0
    tilt_urad: float = 4.0
    range_offset_um: float = 4.0
    scale_ppm: float = 1.0
    scale_drift_ppm: float = 2.0
    bending_urad_per_m: float = 0.5
    delay_us: float = 20.0
    reflector_um: float = 1.0


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
