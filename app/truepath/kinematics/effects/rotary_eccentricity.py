"""A ring scale, or its coupling, off the axis: one wave per turn.

The rigid-body model has it in the axis' own positioning. As a family, it is an
eccentricity that the model in use does not have, or that has changed since.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from truepath.kinematics.conditions import Conditions
from truepath.kinematics.effects.base import Effect, columns_along
from truepath.kinematics.effects.error_motion import find_arm, reference_position_mm
from truepath.kinematics.effects.family import (
    Candidate,
    CandidateEstimate,
    Family,
    Quantity,
    read_words,
)
from truepath.kinematics.effects.keys import ROTARY_AXIS
from truepath.kinematics.effects.sinusoid import (
    find_amplitude_and_phase,
    sine_and_cosine,
)
from truepath.kinematics.machine.machine import RotaryAxis

_USUAL_RAD = 2e-5
_LEAST_TURN_DEG = 180.0  # over less, one wave per turn looks like any bend


@dataclass(frozen=True)
class RotaryEccentricity(Effect):
    """Positioning of a rotary axis as sine and cosine of its angle, 0 at its zero."""

    kind = "rotary-eccentricity"
    units = dict.fromkeys(("sin", "cos"), "rad")
    axis: RotaryAxis

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 2"]:
        """Lever of a turn about the axis, times the waves."""
        name = self.axis.name
        zero = np.array([reference_position_mm(self.axis)])
        waves = sine_and_cosine(np.radians(at.axis_mm(name)))
        waves = waves - sine_and_cosine(np.radians(zero))
        return columns_along(find_arm(f"E{name}{name}", at), waves)


class RotaryEccentricityFamily(Family):
    """One candidate per rotary axis that turns far enough."""

    name = "rotary-eccentricity"
    is_rigid_body = True
    varies_with = "place"
    effect = RotaryEccentricity
    keys = {"axis": ROTARY_AXIS}
    words = read_words("""
        [en]
        title = Eccentricity
        cause = The ring scale or its coupling sits off the axis: as mounted, after a
            crash, or because it was exchanged.
        looks_like = A wave in the angle of a rotary axis, once a turn.
        remedy = Enter the wave in the axis' positioning table; centre the scale, or
            read it with two heads.
        [de]
        title = Exzentrizität
        cause = Der Ringmaßstab oder seine Kupplung sitzt neben der Achse: seit dem
            Einbau, nach einem Aufprall oder einem Tausch.
        looks_like = Eine Welle im Winkel einer Drehachse, einmal je Umdrehung.
        remedy = Die Welle in die Positioniertabelle der Achse eintragen; den Maßstab
            zentrieren oder mit zwei Köpfen ablesen.
        """)

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        """One per axis that turns far enough."""
        axes = [
            axis
            for axis in at.machine.rotary_axes
            if np.ptp(at.axis_mm(axis.name)) >= _LEAST_TURN_DEG
        ]
        return [
            self.make_candidate(RotaryEccentricity(axis), [_USUAL_RAD] * 2)
            for axis in axes
        ]

    def state(self, found: CandidateEstimate) -> dict[str, Quantity]:
        """Amplitude in µrad, and phase."""
        wave = find_amplitude_and_phase(found.theta, found.covariance)
        return {"amplitude_urad": wave[0].scale(1e6), "phase_rad": wave[1]}
