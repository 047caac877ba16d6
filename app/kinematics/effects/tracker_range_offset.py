"""A wrong home distance of the tracker, or a wrong offset of the reflector."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.kinematics.conditions import Conditions
from app.kinematics.effects.base import Effect, Role
from app.kinematics.effects.catalogue import USUAL_MM, Candidate, Family, read_words


@dataclass(frozen=True)
class TrackerRangeOffset(Effect):
    """Every distance is too long by the same amount."""

    kind = "tracker-range-offset"
    role = Role.MEASUREMENT
    units = {"": "mm"}

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 1"]:
        """Return the unit beam in the frame the tracker stands on."""
        if at.recorded is None:
            return np.zeros((len(at), 3, 1))
        distance = np.linalg.norm(at.recorded.tracker_mm, axis=1, keepdims=True)
        beam = at.recorded.tracker_mm / distance
        return (beam @ at.recorded.rotation)[:, :, None]


class TrackerRangeOffsetFamily(Family):
    """One candidate."""

    name = "tracker-range-offset"
    role = Role.MEASUREMENT
    stated = {"offset_um": 1e3}
    words = read_words("""
        [en]
        title = Range offset of the tracker
        cause = The tracker's home distance, or the constant of the reflector in use, is
            wrong.
        looks_like = All points lie too far from the tracker by the same amount: the
            volume looks bent about it.
        remedy = Set the home distance again with the reflector in its nest; choose the
            right reflector in the tracker's software.
        [de]
        title = Distanzversatz des Trackers
        cause = Die Nulldistanz des Trackers oder die Konstante des verwendeten
            Reflektors ist falsch.
        looks_like = Alle Punkte liegen um denselben Betrag zu weit vom Tracker: Der
            Raum wirkt um ihn gebogen.
        remedy = Die Nulldistanz mit dem Reflektor in seiner Aufnahme neu setzen; in der
            Software des Trackers den richtigen Reflektor wählen.
        """)

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        """Return the offset."""
        if at.recorded is None:
            return []
        return [self.offer(TrackerRangeOffset(), [4.0 * USUAL_MM])]
