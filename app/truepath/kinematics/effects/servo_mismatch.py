"""An axis that lags behind its command by more than the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from truepath.kinematics.conditions import Conditions
from truepath.kinematics.effects.base import Effect, columns_along
from truepath.kinematics.effects.error_motion import find_arm
from truepath.kinematics.effects.family import Candidate, Family, read_words
from truepath.kinematics.effects.keys import AXIS
from truepath.kinematics.machine.machine import LinearAxis

_USUAL_S = 1e-4


@dataclass(frozen=True)
class ServoMismatch(Effect):
    """Following error of one axis: its speed times a lag, θ."""

    kind = "servo-mismatch"
    units = {"": "s"}
    axis: LinearAxis

    @property
    def lag_axis(self) -> str:
        """The axis that lags."""
        return self.axis.name

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 1"]:
        """Displacement behind the command per second of lag."""
        arm = find_arm(f"E{self.axis.name}{self.axis.name}", at)
        return columns_along(arm, -at.axis_rate(self.axis.name))


class ServoMismatchFamily(Family):
    """One candidate per axis that moves together with others."""

    name = "servo-mismatch"
    varies_with = "way"
    effect = ServoMismatch
    keys = {"axis": AXIS}
    stated = {"lag_ms": 1e3}
    words = read_words("""
        [en]
        title = Servo mismatch
        cause = The position loops of the axes are not matched: one has another gain or
            feed-forward.
        looks_like = Lines of several axes are displaced sideways in proportion to that
            axis' speed, to the other side on the way back; nothing at standstill.
        remedy = Match the servo gains (kv) and feed-forward of the axes; run a circular
            test to confirm.
        [de]
        title = Ungleiche Lageregler
        cause = Die Lageregler der Achsen sind nicht abgeglichen: Einer hat eine andere
            Verstärkung oder Vorsteuerung.
        looks_like = Geraden mehrerer Achsen sind im Verhältnis zur Geschwindigkeit
            dieser Achse zur Seite versetzt, auf dem Rückweg zur anderen; im Stillstand
            nichts.
        remedy = Verstärkung (Kv) und Vorsteuerung der Achsen abgleichen; mit einem
            Kreisformtest bestätigen.
        """)

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        """One per axis; none where nothing is measured in motion."""
        if at.recorded is None or not at.recorded.rate.any():
            return []
        axes = at.machine.linear_axes
        return [self.make_candidate(ServoMismatch(axis), [_USUAL_S]) for axis in axes]
