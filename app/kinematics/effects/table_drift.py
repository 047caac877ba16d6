"""Tracker or table that creeps steadily during the measurement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.kinematics.conditions import Conditions
from app.kinematics.effects.base import Effect, Role
from app.kinematics.effects.catalogue import USUAL_MM, Candidate, Family, read_words


@dataclass(frozen=True)
class TableDrift(Effect):
    """A shift of all points that grows with time, from the middle of the run."""

    kind = "table-drift"
    role = Role.MEASUREMENT
    units = dict.fromkeys("xyz", "mm/s")
    middle_s: float

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 3"]:
        """Return the time since the middle, for each direction."""
        return (at.time_s - self.middle_s)[:, None, None] * np.eye(3)


class TableDriftFamily(Family):
    """One candidate."""

    name = "table-drift"
    role = Role.MEASUREMENT
    stated = {f"rate_um_per_s[{axis}]": 1e3 for axis in "xyz"}
    words = read_words("""
        [en]
        title = Drift of tracker or table
        cause = The tracker's stand, the table or its clamping creeps, or the tracker
            had not warmed up.
        looks_like = All lines shift evenly with time, whatever axis moves.
        remedy = Let the tracker warm up and settle, clamp its base, close the path by
            measuring the first lines again.
        [de]
        title = Drift von Tracker oder Tisch
        cause = Das Stativ des Trackers, der Tisch oder seine Spannung kriecht, oder der
            Tracker war nicht warmgelaufen.
        looks_like = Alle Geraden verschieben sich gleichmäßig mit der Zeit, gleich
            welche Achse fährt.
        remedy = Den Tracker warmlaufen und sich setzen lassen, seinen Fuß festspannen,
            die Bahn schließen und dazu die ersten Geraden noch einmal messen.
        """)

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        """Return the drift."""
        span = max(float(np.ptp(at.time_s)), 1.0)
        middle = 0.5 * float(at.time_s.min() + at.time_s.max())
        return [self.offer(TableDrift(middle), [2.0 * USUAL_MM / span] * 3)]
