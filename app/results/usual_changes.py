"""What a machine usually does otherwise after a while: play, and growth by warmth."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from truepath.app.kinematics.conditions import Conditions
from truepath.app.kinematics.effects.error_motion import find_arm, find_usual_size

_GROWTH = 5e-5  # of a length: steel that is some 4 K warmer


def list_usual_changes_mm(at: Conditions) -> Float64[np.ndarray, "n 3 c"]:
    """Return what usual lost motion and usual growth of each axis move the target by.

    Growth is of linear axes; from where it is counted is no matter: a shift of all
    places goes with the pose.
    """
    machine = at.machine
    moved: list[Float64[np.ndarray, "n 3"]] = []
    for column, axis in enumerate(machine.axes):
        symbol = f"E{axis.name}{axis.name}"
        arm = find_arm(symbol, at)
        moved.append(find_usual_size(symbol) * arm * at.approach[:, [column]])
        if axis in machine.linear_axes:
            moved.append(_GROWTH * arm * at.position_mm[:, [column]])
    return np.stack(moved, axis=2)
