"""Systematic errors of a tracker within its specification, as in its file."""

from __future__ import annotations

from dataclasses import dataclass


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
