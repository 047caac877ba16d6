"""A weak prior that keeps tables finite before the lines determine them.

Errors of a tenth of a millimetre and a milliradian, a hundred times what they are known
to at the end.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float64

from truepath.app.kinematics.effects.base import Effect, Parameter, Role

_WEAK = {"mm": 0.1, "rad": 1e-3}
# Pose, placement and timing, in mm, rad, mm/s: as good as nothing, yet not so little
# that it drowns in the rounding of what is known.
_WEAK_NUISANCE = {"mm": 10.0, "rad": 1e-2}
_WEAK_SPEED = 10.0


def list_weak_precisions(effects: Iterable[Effect]) -> Float64[np.ndarray, " p"]:
    """Return the precision of each parameter, in the order of the effects.

    1/mm², 1/rad² and so on, in the unit of the parameter.
    """
    return np.array([_find_sigma(e, p) ** -2 for e in effects for p in e.parameters])


def _find_sigma(effect: Effect, parameter: Parameter) -> float:
    if effect.role is Role.NUISANCE:
        return _WEAK_NUISANCE.get(parameter.unit, _WEAK_SPEED)
    return _WEAK.get(parameter.unit, 1.0)
