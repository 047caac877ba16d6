"""How the measured targets sit on the workpiece, seen by a tracker on the base.

At the axis zero they need not be where the file says to a micrometre; relative to the
tool they may be shifted and turned as a whole, in every Run anew.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.kinematics.conditions import Conditions
from app.kinematics.effects.base import Effect, Parameter, Role, name_in_run
from app.numerics.rigid import cross_matrix


@dataclass(frozen=True)
class WorkpiecePlacement(Effect):
    """A small shift (k = 0, 1, 2) or turn (3, 4, 5) of all targets on the workpiece.

    centre_mm : about which they turn
    run : the Run that it belongs to; the targets of others are not moved
    """

    role = Role.NUISANCE
    k: int
    centre_mm: tuple[float, float, float]
    run: int = 0

    def spell(self, digits: str) -> str:
        """Return shift or turn, direction and Run."""
        del digits
        kind = "shift" if self.k < 3 else "turn"
        return name_in_run(f"workpiece-{kind}-{'xyz'[self.k % 3]}", self.run)

    @property
    def own_run(self) -> int:
        """The Run of these targets."""
        return self.run

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The shift or the angle."""
        return (Parameter(self.name, "mm" if self.k < 3 else "rad"),)

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 1"]:
        """Return R d, or R (d × arm), R the turn of the workpiece in the base."""
        if at.run != self.run:
            return np.zeros((len(at), 3, 1))
        unit = np.eye(3)[:, self.k % 3]
        arm = np.tile(unit, (len(at), 1))
        if self.k >= 3:
            arm = cross_matrix(at.offset_mm - np.array(self.centre_mm)) @ unit
        return np.einsum("nij,nj->ni", at.chain.workpiece_frame, arm)[:, :, None]


def workpiece_placement(
    offsets_mm: Float64[np.ndarray, "t 3"], run: int = 0
) -> tuple[WorkpiecePlacement, ...]:
    """Return the six effects for the targets of a Run on the workpiece."""
    x, y, z = (float(v) for v in offsets_mm.mean(axis=0))
    return tuple(WorkpiecePlacement(k, (x, y, z), run) for k in range(6))
