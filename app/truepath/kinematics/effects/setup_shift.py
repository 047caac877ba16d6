"""Shifts of the set-up: a steady creep, or an unintended shift at one moment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from truepath.kinematics.conditions import Conditions
from truepath.kinematics.effects.base import Effect, Role
from truepath.kinematics.effects.family import (
    USUAL_MM,
    Candidate,
    CandidateEstimate,
    Family,
    Quantity,
    Scan,
    read_words,
)


@dataclass(frozen=True)
class TableDrift(Effect):
    """A shift of all points that grows with time, from the middle of the run."""

    kind = "table-drift"
    role = Role.MEASUREMENT
    units = dict.fromkeys("xyz", "mm/s")
    middle_s: float

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 3"]:
        """Time since the middle, for each direction."""
        return (at.time_s - self.middle_s)[:, None, None] * np.eye(3)


class TableDriftFamily(Family):
    """A single candidate, for any machine."""

    name = "table-drift"
    effect = TableDrift
    varies_with = "time"
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
        """A single candidate."""
        span = max(float(np.ptp(at.time_s)), 1.0)
        return [
            self.make_candidate(TableDrift(at.middle_s), [2.0 * USUAL_MM / span] * 3)
        ]


_STEP_S = 2.0
_MOST = 80
_AXES = ("x", "y", "z")


@dataclass(frozen=True)
class SetupStep(Effect):
    """All points shift at one moment, by half of it to either side of the mean."""

    kind = "setup-step"
    role = Role.MEASUREMENT
    units = dict.fromkeys(_AXES, "mm")
    t_s: float

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 3"]:
        """½ after the moment and −½ before."""
        side = np.where(at.time_s >= self.t_s, 0.5, -0.5)
        return side[:, None, None] * np.eye(3)


class SetupStepFamily(Family):
    """One candidate, its moment scanned."""

    name = "setup-step"
    effect = SetupStep
    varies_with = "time"
    is_smooth = False
    happens_once = True
    value_name = "t_s"
    words = read_words("""
        [en]
        title = Step of the set-up
        cause = Tracker, its stand, the target's nest or the workpiece was knocked or
            slipped.
        looks_like = From one moment on all lines are shifted by the same amount.
        remedy = Measure again; until then, use the data with the step taken out.
        [de]
        title = Sprung des Aufbaus
        cause = Tracker, sein Stativ, die Aufnahme des Reflektors oder das Werkstück
            wurde angestoßen oder ist verrutscht.
        looks_like = Von einem Zeitpunkt an sind alle Geraden um denselben Betrag
            verschoben.
        remedy = Noch einmal messen; bis dahin die Daten ohne den Sprung verwenden.
        """)

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        """A single candidate, at the middle of the Run."""
        return [self.make_candidate(SetupStep(at.middle_s), [USUAL_MM] * 3)]

    def scan(self, candidate: Candidate, at: Conditions) -> Scan:
        """Moments, none so early or late that one line would decide.

        Mostly between lines: a step elsewhere splits a line in two.
        """
        first, last = float(at.time_s.min()), float(at.time_s.max())
        margin = 0.02 * (last - first)
        count = int(min(_MOST, max(8, (last - first) / _STEP_S)))
        even = np.linspace(first + margin, last - margin, count)
        between = _between_lines(at)
        inside = (between > even[0]) & (between < even[-1])
        return Scan(self.value_name, np.union1d(even, between[inside]))

    def state(self, found: CandidateEstimate) -> dict[str, Quantity]:
        """Moment in s, and step in µm."""
        steps = zip(_AXES, found.parameters, strict=True)
        shifts = {f"step_um[{axis}]": step.scale(1e3) for axis, step in steps}
        return {"t_s": found.value, **shifts}


def _between_lines(at: Conditions) -> Float64[np.ndarray, " l"]:
    order = np.argsort(at.time_s, kind="stable")
    time_s, line = at.time_s[order], at.line[order]
    last = np.flatnonzero((np.diff(line) != 0) | (line[1:] < 0))
    return 0.5 * (time_s[last] + time_s[last + 1])
