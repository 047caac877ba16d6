"""By how much a tracker in order may be off: the systematic part of its uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

from truepath.kinematics.effects.base import Effect
from truepath.kinematics.effects.tracker_air import BeamBending
from truepath.kinematics.effects.tracker_error import (
    ElevationIndex,
    TrackerEccentricity,
    TrackerRangeOffset,
)


@dataclass(frozen=True, slots=True)
class TrackerSpecification:
    """Standard uncertainties of what a tracker in order may be off by.

    eccentricity_rad : amplitude of each circle; index_rad : of the elevation's zero
    range_offset_mm : of the home distance, with the reflector
    bending_rad_per_mm : curvature of the beam; 0.9e-9 for each kelvin a metre of height
    """

    eccentricity_rad: float = 1e-6
    index_rad: float = 1e-6
    range_offset_mm: float = 1e-3
    bending_rad_per_mm: float = 0.3e-9

    def list_effects(self) -> tuple[tuple[Effect, float, bool], ...]:
        """Return each cause, its standard uncertainty, and whether stations share it.

        Circles lie about the plumb line anyhow at each station: the azimuth's phase is
        another every time. All else stays with the tracker, and the air with the hall.
        """
        part = self.eccentricity_rad / 2.0**0.5
        return (
            (TrackerEccentricity("azimuth"), part, False),
            (TrackerEccentricity("elevation"), part, True),
            (ElevationIndex(), self.index_rad, True),
            (TrackerRangeOffset(), self.range_offset_mm, True),
            (BeamBending(), self.bending_rad_per_mm, True),
        )
