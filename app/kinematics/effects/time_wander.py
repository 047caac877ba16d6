"""A slow shift of everything with time that is neither steady nor a step nor a wave."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.kinematics.conditions import Conditions
from app.kinematics.effects.base import Effect, Role, columns_along
from app.kinematics.effects.catalogue import (
    USUAL_MM,
    Candidate,
    CandidateEstimate,
    Family,
    Quantity,
    read_words,
)
from app.kinematics.effects.keys import DIRECTION
from app.kinematics.symbols import LINEAR

_HALF_WAVES = range(1, 13)


@dataclass(frozen=True)
class TimeWander(Effect):
    """A cosine series over the run, in one direction; θ by number of half waves."""

    kind = "time-wander"
    role = Role.STRUCTURE
    units = {f"{k}": "mm" for k in _HALF_WAVES}
    direction: str
    first_s: float
    span_s: float

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 p"]:
        """Return the direction times the cosines."""
        angle = np.pi * (at.time_s - self.first_s) / self.span_s
        return columns_along(self.direction, np.cos(angle[:, None] * [*_HALF_WAVES]))


class TimeWanderFamily(Family):
    """Every direction."""

    name = "time-wander"
    role = Role.STRUCTURE
    keys = {"direction": DIRECTION}
    covariates = ("t",)
    sentence = "a slow wander along {direction} of {rms_um:.2g} µm (root mean square)"
    words = read_words("""
        [en]
        title = Slow wander in time
        cause = Mount, table or air that wanders: sun, draught, a hall that cools.
        looks_like = All points shift slowly to and fro with time, whatever axis moves.
        remedy = Let all settle, shield it from draught and sun, measure faster; repeat
            lines to see it.
        [de]
        title = Langsames Wandern mit der Zeit
        cause = Halterung, Tisch oder Luft wandert: Sonne, Zugluft, eine abkühlende
            Halle.
        looks_like = Alle Punkte verschieben sich mit der Zeit langsam hin und her,
            gleich welche Achse fährt.
        remedy = Alles zur Ruhe kommen lassen, vor Zugluft und Sonne schützen, schneller
            messen; Geraden wiederholen, um es zu sehen.
        """)

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        """Return one a direction; the slower a wave, the higher it usually is."""
        first_s, span_s = float(at.time_s.min()), max(float(np.ptp(at.time_s)), 1.0)
        usual = USUAL_MM / np.array(_HALF_WAVES)
        return [self.offer(TimeWander(d, first_s, span_s), usual) for d in LINEAR]

    def state(self, found: CandidateEstimate) -> dict[str, Quantity]:
        """Return the root mean square over the run."""
        half = np.full(len(_HALF_WAVES), 0.5)
        return {"rms_um": found.root_mean_square(half).scale(1e3)}
