"""Errors in proportion to the speed of an axis: a lag, or a displacement across it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from truepath.kinematics.conditions import Conditions
from truepath.kinematics.effects.base import Effect, Role, columns_along
from truepath.kinematics.effects.error_motion import compute_arm
from truepath.kinematics.effects.family import (
    USUAL_MM,
    Candidate,
    CandidateEstimate,
    Family,
    Quantity,
    read_words,
)
from truepath.kinematics.effects.keys import AXIS, DIRECTION
from truepath.kinematics.machine.machine import LinearAxis

_TYPICAL_S = 1e-4


@dataclass(frozen=True)
class ServoMismatch(Effect):
    """Following error of one axis: its speed times a lag, θ."""

    kind = "servo-mismatch"
    units = {"": "s"}
    axis: LinearAxis

    @property
    def lag_axis(self) -> str:
        return self.axis.name

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 1"]:
        arm = compute_arm(f"E{self.axis.name}{self.axis.name}", at)
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
        return [self.make_candidate(ServoMismatch(axis), [_TYPICAL_S]) for axis in axes]


_LEAST_SPREAD = 0.1  # of the highest speed: less gives no information about speed


@dataclass(frozen=True)
class SpeedError(Effect):
    """An error motion in proportion to speed and to its square.

    fastest_mm_s : the highest speed measured of the axis
    θ : displacement at the highest speed from speed, and from its square
    """

    kind = "speed-error"
    role = Role.STRUCTURE
    units = {"v": "mm", "v2": "mm"}
    axis: LinearAxis
    direction: str
    fastest_mm_s: float

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 2"]:
        speed = np.abs(at.axis_rate(self.axis.name)) / self.fastest_mm_s
        arm = compute_arm(f"E{self.direction}{self.axis.name}", at)
        return columns_along(arm, np.stack([speed, speed**2], axis=1))


class SpeedErrorFamily(Family):
    """One candidate per axis measured at several speeds, and direction."""

    name = "speed-error"
    varies_with = "way"
    effect = SpeedError
    keys = {"axis": AXIS, "direction": DIRECTION}
    numbers = ("fastest_mm_s",)
    covariates = ("v({axis})",)
    sentence = (
        "a displacement along {direction} that depends on how fast {axis} moves, "
        "whichever way: {amplitude_um:.2g} µm at {fastest_mm_s:.3g} mm/s"
    )
    words = read_words("""
        [en]
        title = Error that depends on speed
        cause = A slide that floats up on its oil, or a drive that pulls it aside, the
            more the faster it goes.
        looks_like = Lines lie apart by the speed of an axis, alike on the way there and
            back.
        remedy = Measure at the feed that parts are finished at; check way oil and the
            preload of the guide.
        [de]
        title = Fehler, der von der Geschwindigkeit abhängt
        cause = Ein Schlitten, der auf seinem Öl aufschwimmt, oder ein Antrieb, der ihn
            zur Seite zieht, je schneller, desto mehr.
        looks_like = Die Geraden liegen je nach Geschwindigkeit einer Achse auseinander,
            auf Hin- und Rückweg gleich.
        remedy = Mit dem Vorschub messen, mit dem Teile geschlichtet werden; Bettbahnöl
            und Vorspannung der Führung prüfen.
        """)

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        found: list[Candidate] = []
        for axis in at.machine.linear_axes:
            speed = np.abs(at.axis_rate(axis.name))
            fastest = float(speed.max(initial=0.0))
            if np.std(speed) <= _LEAST_SPREAD * fastest:
                continue
            found += [
                self.make_candidate(
                    SpeedError(axis, other.name, fastest), [USUAL_MM] * 2
                )
                for other in at.machine.linear_axes
            ]
        return found

    def state(self, found: CandidateEstimate) -> dict[str, Quantity]:
        sigma = float(np.sqrt(found.covariance.sum()))
        return {"amplitude_um": Quantity(float(found.theta.sum()), sigma).scale(1e3)}
