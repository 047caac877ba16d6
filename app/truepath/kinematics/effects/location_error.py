"""Location errors: squareness of linear axes, and where the axis of a rotary axis is.

Squareness is the slope that straightness leaves to it. The rigid-body model has all of
them. As a family, it is a squareness that the model in use does not have, or that has
changed since.

A rotary axis may be shifted and tilted against its nominal location: XOC, YOC, AOC, BOC
of a C axis, and so on. At the axis zero a wrong location moves nothing; from there it
moves the target by (1 − R) g on the tool side, (R − 1) g on the workpiece side. Error
motions across the axis have no mean over the travel: their mean would be location,
as slopes of straightness are squareness.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from truepath.kinematics.conditions import Conditions
from truepath.kinematics.effects.base import Effect, Parameter
from truepath.kinematics.effects.error_motion import reference_position_mm
from truepath.kinematics.effects.family import Candidate, Family, read_words
from truepath.kinematics.effects.keys import SYMBOL
from truepath.kinematics.machine.machine import RotaryAxis, find_local_directions
from truepath.kinematics.machine.symbols import DIRECTION, TURNS, list_locations

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
        """Lean: a displacement in proportion to the axis' position."""
        name, direction, sign = _LEAN[self.symbol]
        axis = next(a for a in at.machine.linear_axes if a.name == name)
        lean = np.zeros((len(at), 3))
        lean[:, direction] = sign * (at.axis_mm(name) - reference_position_mm(axis))
        return at.chain.lever(name).displace(lean, is_turn=False)[:, :, None]


def list_squarenesses(axes: tuple[str, ...]) -> tuple[Squareness, ...]:
    """One per pair among the given linear axes."""
    pairs = {"C0Y": {"X", "Y"}, "B0Z": {"X", "Z"}, "A0Z": {"Y", "Z"}}
    return tuple(Squareness(s) for s, pair in pairs.items() if pair <= set(axes))


class SquarenessFamily(Family):
    """One candidate per pair of linear axes."""

    name = "squareness"
    is_rigid_body = True
    effect = Squareness
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
        """One per pair of axes."""
        names = tuple(axis.name for axis in at.machine.linear_axes)
        return [self.make_candidate(s, [_USUAL_RAD]) for s in list_squarenesses(names)]


@dataclass(frozen=True)
class AxisLocation(Effect):
    """A shift of the axis, or a tilt about its origin, in its local directions."""

    symbol: str
    axis: RotaryAxis

    @property
    def iso_symbol(self) -> str:
        """Its own symbol."""
        return self.symbol

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The shift or the angle."""
        return (Parameter(self.symbol, "rad" if self.symbol[0] in TURNS else "mm"),)

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 1"]:
        """F (1 − R) d, with × L for a tilt."""
        unit = find_local_directions(self.axis)[:, DIRECTION[self.symbol[0]]]
        chain = at.chain
        turn = chain.turns[self.axis.name]
        if self.axis.name in at.machine.workpiece_side:
            # The error is behind the joint: R there is that of the workpiece.
            direction = np.einsum("nji,j->ni", turn, unit) - unit
        else:
            direction = unit - np.einsum("nij,j->ni", turn, unit)
        is_turn = self.symbol[0] in TURNS
        lever = chain.lever(self.axis.name)
        return lever.displace(direction, is_turn=is_turn)[:, :, None]


def list_axis_locations(axis: RotaryAxis) -> tuple[AxisLocation, ...]:
    """Four per rotary axis, shifts first."""
    return tuple(AxisLocation(symbol, axis) for symbol in list_locations(axis.name))
