"""A guide that bends under another axis' carriage: not a rigid-body error.

A beam on two supports gives way most in its middle, and by the share of the weight that
rests on it: that share grows with the other axis' position. In one direction the
displacement is −amplitude · 4u(1 − u) · v, with u along the guide and v along the
carriage's travel, both from 0 to 1. A heavy carriage makes the deflection under itself
that of a travelling load, (4u(1 − u))².

A swivel that carries its weight off its axis loads a guide by sine and cosine of its
angle.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np
from jaxtyping import Float64

from truepath.kinematics.conditions import Conditions
from truepath.kinematics.effects.base import Effect, columns_along
from truepath.kinematics.effects.error_motion import compute_arm
from truepath.kinematics.effects.family import (
    USUAL_MM,
    Candidate,
    Family,
    read_words,
)
from truepath.kinematics.effects.keys import AXIS, DIRECTION, ROTARY_AXIS
from truepath.kinematics.effects.sinusoid import (
    WaveFamily,
    sine_and_cosine,
)
from truepath.kinematics.machine.machine import Axis, LinearAxis
from truepath.kinematics.machine.symbols import LINEAR

_UNDER = replace(AXIS, phrase="under {}")


@dataclass(frozen=True)
class Sag(Effect):
    """A guide yields in one direction under the load of another axis.

    axis : the guide; by : the axis that carries the load
    """

    axis: LinearAxis
    by: Axis
    direction: str

    @property
    def axis_pair(self) -> tuple[str, str]:
        return self.axis.name, self.by.name

    @abstractmethod
    def load(self, at: Conditions) -> Float64[np.ndarray, "n p"]:
        """Load for each parameter, at most 1."""

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 p"]:
        u = at.axis_share(self.axis)
        bend = -4.0 * u * (1.0 - u)
        arm = compute_arm(f"E{self.direction}{self.axis.name}", at)
        return columns_along(arm, bend[:, None] * self.load(at))


@dataclass(frozen=True)
class ElasticSag(Sag):
    """Displacement in one direction by the product of two positions.

    θ : the displacement at mid guide under the carriage's far end
    """

    kind = "elastic-sag"
    units = {"": "mm"}

    def load(self, at: Conditions) -> Float64[np.ndarray, "n 1"]:
        return at.axis_share(self.by)[:, None]


@dataclass(frozen=True)
class SwivelSag(Sag):
    """Displacement of a guide in one direction by the weight that a swivel carries.

    Its centre of gravity is off the swivel's axis, so the load on the guide varies with
    sine and cosine of the angle. θ : both at mid guide
    """

    kind = "swivel-sag"
    units = {"sin": "mm", "cos": "mm"}

    def load(self, at: Conditions) -> Float64[np.ndarray, "n 2"]:
        return sine_and_cosine(np.radians(at.axis_mm(self.by.name)))


class ElasticSagFamily(Family):
    """One candidate per ordered pair of axes and direction."""

    name = "elastic-sag"
    varies_with = "place"
    effect = ElasticSag
    keys = {"axis": AXIS, "by": _UNDER, "direction": DIRECTION}
    stated = {"amplitude_um": 1e3}
    words = read_words("""
        [en]
        title = Sag of a guide
        cause = A guide or cross beam bends under the carriage that travels on it, or
            under what hangs from it.
        looks_like = The straightness or positioning of one axis depends on where
            another stands: tables of single axes cannot show it.
        remedy = Use the controller's cross-axis (sag) compensation for the pair; check
            counterbalance and levelling.
        [de]
        title = Durchbiegung einer Führung
        cause = Eine Führung oder ein Querbalken biegt sich unter dem Schlitten, der
            darauf fährt, oder unter dem, was daran hängt.
        looks_like = Geradheit oder Positionierung einer Achse hängt davon ab, wo eine
            andere steht: Tabellen einzelner Achsen können das nicht zeigen.
        remedy = Die Durchhangkompensation der Steuerung für dieses Achspaar nutzen;
            Gewichtsausgleich und Nivellierung prüfen.
        """)

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        return [
            self.make_candidate(ElasticSag(axis, by, direction), [2.0 * USUAL_MM])
            for axis, by in permutations(at.machine.linear_axes, 2)
            for direction in LINEAR
        ]


class SwivelSagFamily(WaveFamily):
    """One candidate per guide, rotary axis and direction."""

    name = "swivel-sag"
    varies_with = "place"
    effect = SwivelSag
    keys = {
        "axis": AXIS,
        "by": replace(ROTARY_AXIS, phrase="under {}"),
        "direction": DIRECTION,
    }
    words = read_words("""
        [en]
        title = Sag of a guide that depends on a swivel
        cause = A head or table that swivels carries its weight off its axis, and the
            guide below bends as it turns.
        looks_like = The straightness or positioning of a straight axis depends on the
            angle of a rotary one, by its sine and cosine.
        remedy = Check counterweight and guide; compensate straightness for the angles
            that are worked at.
        [de]
        title = Durchbiegung einer Führung, die von einer Schwenkachse abhängt
        cause = Ein Kopf oder Tisch, der schwenkt, trägt sein Gewicht außerhalb seiner
            Achse, und die Führung darunter biegt sich beim Drehen.
        looks_like = Geradheit oder Positionierung einer Linearachse hängt vom Winkel
            einer Drehachse ab, als deren Sinus und Kosinus.
        remedy = Gegengewicht und Führung prüfen; die Geradheit für die Winkel
            kompensieren, bei denen gearbeitet wird.
        """)

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        return [
            self.make_candidate(SwivelSag(axis, by, direction), [2.0 * USUAL_MM] * 2)
            for axis in at.machine.linear_axes
            for by in at.machine.rotary_axes
            for direction in LINEAR
        ]
