"""Tables that a controller interpolates straight between rows and adds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.compensation.format import Correction
from app.kinematics.machine import Machine


@dataclass(frozen=True, slots=True)
class InterpolatedTable:
    """What a controller adds at positions of an axis; end values hold beyond.

    out : index of the axis that is corrected
    forward_mm, backward_mm : (n,) added in + and in − direction of the axis
    """

    axis: str
    out: int
    position_mm: Float64[np.ndarray, " n"]
    forward_mm: Float64[np.ndarray, " n"]
    backward_mm: Float64[np.ndarray, " n"]


def add_tables(tables: Sequence[InterpolatedTable], machine: Machine) -> Correction:
    """Return the sum of tables as a correction."""

    def correction(
        position_mm: Float64[np.ndarray, "n a"], direction: float
    ) -> Float64[np.ndarray, "n 3"]:
        added = np.zeros((len(position_mm), 3))
        for table in tables:
            at = position_mm[:, machine.axis_names.index(table.axis)]
            value_mm = table.forward_mm if direction > 0 else table.backward_mm
            added[:, table.out] += np.interp(at, table.position_mm, value_mm)
        return added

    return correction
