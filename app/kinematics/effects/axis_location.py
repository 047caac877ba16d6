"""Where the axis of a rotary axis is: shifted and tilted against its nominal place.

XOC, YOC, AOC, BOC of a C axis, and so on. At the axis zero a wrong location moves
nothing; from there it moves the target by what the turn makes of it: (1 − R) g on the
tool side, (R − 1) g on the workpiece side. Error motions across the axis have no mean
over the travel: what they would have is location, as slopes of straightness are
squareness.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.kinematics.conditions import Conditions
from app.kinematics.effects.base import Effect, Parameter
from app.kinematics.machine import RotaryAxis, find_local_directions
from app.kinematics.symbols import DIRECTION, TURNS, list_locations


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
        """Return F (1 − R) d, with × L for a tilt."""
        unit = find_local_directions(self.axis)[:, DIRECTION[self.symbol[0]]]
        chain = at.chain
        turn = chain.turns[self.axis.name]
        if self.axis.name in at.machine.workpiece_side:
            # The error sits behind the joint: R there is that of the workpiece.
            direction = np.einsum("nji,j->ni", turn, unit) - unit
        else:
            direction = unit - np.einsum("nij,j->ni", turn, unit)
        is_turn = self.symbol[0] in TURNS
        lever = chain.lever(self.axis.name)
        return lever.displace(direction, is_turn=is_turn)[:, :, None]


def list_axis_locations(axis: RotaryAxis) -> tuple[AxisLocation, ...]:
    """Return the four location errors of a rotary axis, shifts first."""
    return tuple(AxisLocation(symbol, axis) for symbol in list_locations(axis.name))
