"""Squareness of two linear axes: the slope that straightness leaves to it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.kinematics.conditions import Conditions
from app.kinematics.effects.base import Effect
from app.kinematics.effects.error_motion import reference_position_mm

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
