"""Keeps commanded positions inside the travel of the axes.

Straight lines in axis positions never leave a box that holds both of their ends, so
checking the rows checks the whole swept path.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.kinematics.machine import Axis, LinearAxis, Machine
from app.planning.configurations import Configurations
from drivers.interfaces.records import Path

# Rows are written with three or four decimals: a limit may be overrun by the rounding.
ROUNDING = 1e-3


@dataclass(frozen=True, slots=True)
class Breach:
    """A commanded position beyond the travel of an axis.

    index : row of the commanded positions, from 0
    value, low, high : mm, or deg for a rotary axis
    """

    index: int
    axis: str
    unit: str
    value: float
    low: float
    high: float

    def __str__(self) -> str:
        side, limit = (
            ("exceeds", self.high) if self.value > self.high else ("is below", self.low)
        )
        return (
            f"{self.axis} = {self.value:.4g} {self.unit} {side} {limit:.4g} {self.unit}"
        )


def first_breach(machine: Machine, commanded: Path | Configurations) -> Breach | None:
    """Return the first row beyond the travel, or None. Every axis must be known."""
    axes = {axis.name: axis for axis in machine.axes}
    limits = [limits_of(axes[name]) for name in commanded.axes]
    low, high = np.array(limits).T
    outside = (commanded.position < low - ROUNDING) | (
        commanded.position > high + ROUNDING
    )
    if not outside.any():
        return None
    row, column = (int(i) for i in np.argwhere(outside)[0])
    name = commanded.axes[column]
    unit = "mm" if isinstance(axes[name], LinearAxis) else "deg"
    value = float(commanded.position[row, column])
    return Breach(row, name, unit, value, *limits[column])


def limits_of(axis: Axis) -> tuple[float, float]:
    """Return the travel of an axis, mm or deg."""
    if isinstance(axis, LinearAxis):
        return axis.min_mm, axis.max_mm
    return axis.min_deg, axis.max_deg
