"""Squareness of two linear axes: the slope that straightness leaves to it.

The rigid-body model has all of them. As a family, it is a squareness that the model in
use has left out, or that has changed since.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.kinematics.conditions import Conditions
from app.kinematics.effects.base import Effect
from app.kinematics.effects.catalogue import Candidate, Family, read_words
from app.kinematics.effects.error_motion import reference_position_mm
from app.kinematics.effects.keys import SYMBOL

_USUAL_RAD = 2e-5
# The axis out of square, which way it leans, the sign of a right-handed turn.
_LEAN = {"C0Y": ("Y", 0, -1.0), "B0Z": ("Z", 0, 1.0), "A0Z": ("Z", 1, -1.0)}


@dataclass(frozen=True)
class Squareness(Effect):
    """C0Y, B0Z or A0Z: the axis leans by a right-handed turn."""

    units = {"": "rad"}
    symbol: str

    @property
    def iso_symbol(self) -> str:
        """Its own symbol."""
        return self.symbol

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 p"]:
        """Return the lean: a displacement in proportion to the axis' position."""
        name, direction, sign = _LEAN[self.symbol]
        axis = next(a for a in at.machine.linear_axes if a.name == name)
        lean = np.zeros((len(at), 3))
        lean[:, direction] = sign * (at.axis_mm(name) - reference_position_mm(axis))
        return at.chain.lever(name).displace(lean, is_turn=False)[:, :, None]


def list_squarenesses(axes: tuple[str, ...]) -> tuple[Squareness, ...]:
    """Return the squarenesses of the given linear axes."""
    pairs = {"C0Y": {"X", "Y"}, "B0Z": {"X", "Z"}, "A0Z": {"Y", "Z"}}
    return tuple(Squareness(s) for s, pair in pairs.items() if pair <= set(axes))


class SquarenessFamily(Family):
    """One candidate a pair of straight axes."""

    name = "squareness"
    is_rigid_body = True
    makes = Squareness
    keys = {"symbol": SYMBOL}
    stated = {"value_urad": 1e6}
    words = read_words("""
        [en]
        title = Squareness
        cause = Two axes are not square to each other: as assembled, after a crash, or
            because the machine was levelled anew.
        looks_like = Lines across the plane of the two axes lean in proportion to the
            travel of one of them; face diagonals differ in length.
        remedy = Enter the angle as squareness compensation; check levelling and the
            joint between the two axes.
        [de]
        title = Rechtwinkligkeit
        cause = Zwei Achsen stehen nicht rechtwinklig zueinander: seit der Montage, nach
            einem Aufprall oder weil die Maschine neu nivelliert wurde.
        looks_like = Geraden quer durch die Ebene der beiden Achsen neigen sich im
            Verhältnis zum Weg der einen; die Diagonalen der Ebene sind verschieden
            lang.
        remedy = Den Winkel als Rechtwinkligkeitskompensation eintragen; Nivellierung
            und Verbindung der beiden Achsen prüfen.
        """)

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        """Return one a pair of axes."""
        names = tuple(axis.name for axis in at.machine.linear_axes)
        return [self.offer(s, [_USUAL_RAD]) for s in list_squarenesses(names)]
