"""A short excursion after an axis has reversed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from truepath.kinematics.conditions import Conditions
from truepath.kinematics.effects.base import Effect, columns_along
from truepath.kinematics.effects.error_motion import find_arm
from truepath.kinematics.effects.family import (
    USUAL_MM,
    Candidate,
    Family,
    Scan,
    read_words,
)
from truepath.kinematics.effects.keys import AXIS, DIRECTION
from truepath.kinematics.machine.machine import LinearAxis

_DECAYS_MM = np.geomspace(3.0, 60.0, 10)


@dataclass(frozen=True)
class ReversalSpike(Effect):
    """Displacement in one direction that decays with the distance since reversal.

    Its sign is that of the axis' present direction.
    θ : the excursion at the reversal
    """

    kind = "reversal-spike"
    units = {"": "mm"}
    axis: LinearAxis
    direction: str
    decay_mm: float

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 1"]:
        """Direction times the remaining part of the excursion."""
        if at.recorded is None:
            return np.zeros((len(at), 3, 1))
        column = at.machine.axis_names.index(self.axis.name)
        left = np.exp(-at.recorded.since_reversal[:, column] / self.decay_mm)
        arm = find_arm(f"E{self.direction}{self.axis.name}", at)
        return columns_along(arm, left * at.approach[:, column])


class ReversalSpikeFamily(Family):
    """One candidate per axis and direction, the decay scanned."""

    name = "reversal-spike"
    varies_with = "way"
    value_name = "decay_mm"
    numbers = ("decay_mm",)
    effect = ReversalSpike
    keys = {"axis": AXIS, "direction": DIRECTION}
    stated = {"amplitude_um": 1e3}
    words = read_words("""
        [en]
        title = Spike at reversal
        cause = Friction holds an axis back for a moment when it reverses, or its guide
            tilts before it settles.
        looks_like = A peak just after each reversal that fades within some millimetres
            of travel; on circles, a spike at the change of quadrant.
        remedy = Tune the controller's friction (quadrant error) compensation; check
            lubrication and the preload of guides and nut.
        [de]
        title = Umkehrspitze
        cause = Reibung hält eine Achse beim Umkehren einen Augenblick fest, oder ihre
            Führung kippt, bevor sie sich setzt.
        looks_like = Eine Spitze kurz nach jeder Umkehr, die nach einigen Millimetern
            Weg abklingt; auf Kreisen eine Spitze am Quadrantenübergang.
        remedy = Die Reibungskompensation (Quadrantenfehler) der Steuerung einstellen;
            Schmierung und Vorspannung von Führungen und Mutter prüfen.
        """)

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        """One per axis that reverses, and direction."""
        axes = at.machine.linear_axes
        return [
            self.make_candidate(ReversalSpike(axis, other.name, 10.0), [USUAL_MM])
            for axis in axes
            for other in axes
            if _reverses(axis, at)
        ]

    def scan(self, candidate: Candidate, at: Conditions) -> Scan:
        """Decay lengths in mm."""
        return Scan(self.value_name, _DECAYS_MM)


def _reverses(axis: LinearAxis, at: Conditions) -> bool:
    if at.recorded is None:
        return False
    column = at.machine.axis_names.index(axis.name)
    return bool((at.recorded.since_reversal[:, column] < _DECAYS_MM[-1]).any())
