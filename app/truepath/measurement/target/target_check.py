"""Check that a point belongs to its stated target.

The distance between two points of one measurement does not depend on the pose of the
tracker: it is known from the stated targets. Targets that are nearer to each other than
the bound are not distinguishable.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from truepath.kinematics.conditions import observe_targets
from truepath.kinematics.machine.machine import Machine

BOUND_MM = 5.0  # targets sit to a millimetre or so, and the machine has its errors
_KEPT = 50


class TargetCheck:
    """Compares each point with those before it, by their distances."""

    def __init__(self, machine: Machine) -> None:
        self._machine = machine
        self._targets = {target.name: target for target in machine.targets}
        self._kept: deque[tuple[NDArray[np.float64], NDArray[np.float64]]] = deque(
            maxlen=_KEPT
        )

    def measure_misfit(
        self, position: dict[str, float], name: str, place_mm: NDArray[np.float64]
    ) -> float:
        """Deviation of a point from its expected position, mm; kept if it fits.

        position : of every axis, by name
        """
        machine = self._machine
        row = np.array([[position.get(axis, 0.0) for axis in machine.axis_names]])
        stated = observe_targets(machine, row, [self._targets[name]]).point_mm[0]
        misfit = max(
            (
                abs(np.linalg.norm(place_mm - place) - np.linalg.norm(stated - other))
                for other, place in self._kept
            ),
            default=0.0,
        )
        if misfit <= BOUND_MM:
            self._kept.append((stated, np.array(place_mm, float)))
        return float(misfit)
