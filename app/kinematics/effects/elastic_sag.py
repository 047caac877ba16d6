"""A guide that bends under another axis' carriage: no rigid body does it.

A beam on two supports gives way most in its middle, and by the share of the weight that
rests on it: that share grows with the other axis' position. In one direction the
displacement is −amplitude · 4u(1 − u) · v, with u along the guide and v along the
carriage's travel, both from 0 to 1. A heavy carriage makes the deflection under itself
that of a travelling load, (4u(1 − u))².
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np
from jaxtyping import Float64

from app.kinematics.conditions import Conditions
from app.kinematics.effects.base import Effect, columns_along
from app.kinematics.effects.catalogue import USUAL_MM, Candidate, Family, read_words
from app.kinematics.effects.keys import AXIS, DIRECTION
from app.kinematics.machine import LinearAxis
from app.kinematics.symbols import LINEAR

_UNDER = replace(AXIS, phrase="under {}")


@dataclass(frozen=True)
class ElasticSag(Effect):
    """Displacement in one direction by the product of two positions.

    θ : the displacement at mid guide under the carriage's far end
    """

    kind = "elastic-sag"
    units = {"": "mm"}
    axis: LinearAxis
    by: LinearAxis
    direction: str

    @property
    def axis_pair(self) -> tuple[str, str]:
        """Guide and carriage."""
        return self.axis.name, self.by.name

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 1"]:
        """Return the direction times the product."""
        u, v = (_share(axis, at) for axis in (self.axis, self.by))
        return columns_along(self.direction, -4.0 * u * (1.0 - u) * v)


def _share(axis: LinearAxis, at: Conditions) -> Float64[np.ndarray, " n"]:
    return (at.axis_mm(axis.name) - axis.low) / (axis.high - axis.low)


class ElasticSagFamily(Family):
    """Every pair of axes and direction."""

    name = "elastic-sag"
    makes = ElasticSag
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
        """Return one for each ordered pair and direction."""
        return [
            self.offer(ElasticSag(axis, by, direction), [2.0 * USUAL_MM])
            for axis, by in permutations(at.machine.linear_axes, 2)
            for direction in LINEAR
        ]
